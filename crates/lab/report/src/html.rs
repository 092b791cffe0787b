//! A report as one self-contained HTML file: its tables, and its data as JSON, which uPlot draws.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::document::{Document, Part, Section, Table};
use super::figure::Figure;

const STYLE: &str = include_str!("report.css");
const SCRIPT: &str = include_str!("report.js");
/// The library that draws, as the page of `joulebus serve` has it.
const LIBRARY: &str = include_str!("uPlot.iife.min.js");
const LIBRARY_STYLE: &str = include_str!("uPlot.min.css");
const LIBRARY_LICENCE: &str = include_str!("uPlot.LICENSE");

/// The document as HTML. `script[type="application/json"]` has what `report.json` has.
///
/// # Errors
/// It cannot be written as JSON.
pub fn html(document: &Document) -> Result<String, serde_json::Error> {
    // In a script only `<` could end it.
    let data = serde_json::to_string(document)?.replace('<', "\\u003c");
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (document.title) }
                style { (PreEscaped(LIBRARY_STYLE)) (PreEscaped(STYLE)) }
            }
            body {
                header {
                    h1 { (document.title) }
                    @if let Some(warning) = &document.warning {
                        p.warning role="note" { (warning) }
                    }
                    @for words in &document.summary { p { (words) } }
                    noscript { p.warning {
                        "The figures need JavaScript. The tables have their numbers."
                    } }
                }
                nav aria-label="Contents" {
                    ol { @for section in &document.sections {
                        li { a href={ "#" (section.id) } { (section.title) } }
                    } }
                }
                main { @for part in &document.sections { (section(part)) } }
                script type="application/json" id="data" { (PreEscaped(data)) }
                script { "/*\n" (PreEscaped(LIBRARY_LICENCE)) "*/\n" (PreEscaped(LIBRARY)) }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    };
    Ok(page.into_string())
}

fn section(section: &Section) -> Markup {
    html! {
        section id=(section.id) {
            h2 { (section.title) }
            @for part in &section.parts {
                @match part {
                    Part::Words(words) => p { (words) },
                    Part::Table(shown) if shown.folded => {
                        details { summary { "Numbers: " (shown.caption) } (table(shown)) }
                    }
                    Part::Table(shown) => (table(shown)),
                    Part::Figure(drawn) => (figure(drawn)),
                }
            }
        }
    }
}

/// A figure, whose panels the script draws.
fn figure(figure: &Figure) -> Markup {
    html! {
        figure id=(figure.name) {
            div.panels {}
            figcaption {
                strong { (figure.title) } " " (figure.description)
                @if let Some(note) = &figure.note { " " em { "(" (note) ")" } }
            }
        }
    }
}

fn table(table: &Table) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label=(table.caption) {
            table id=(table.id) {
                caption { (table.caption) }
                thead { tr { @for (at, column) in table.columns.iter().enumerate() {
                    th scope="col" class=[table.is_of_numbers(at).then_some("number")] {
                        (column.title)
                    }
                } } }
                tbody { @for row in &table.rows { tr {
                    @for (at, cell) in row.iter().enumerate() {
                        @if at == 0 { th scope="row" { (cell.shown()) } }
                        @else {
                            td class=[table.is_of_numbers(at).then_some("number")] { (cell.shown()) }
                        }
                    }
                } } }
            }
        }
    }
}
