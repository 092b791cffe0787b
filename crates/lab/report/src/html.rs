//! A report as one self-contained HTML file.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::document::{Document, Part, Section, Table};
use joulebus_figure::{Colour, Figure, FigureError};

const STYLE: &str = include_str!("report.css");

/// The document as HTML, with its figures as inline SVG.
///
/// # Errors
/// A figure cannot be drawn.
pub fn html(document: &Document) -> Result<String, FigureError> {
    let sections = document.sections.iter().map(section).collect::<Result<Vec<_>, _>>()?;
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (document.title) }
                style { (PreEscaped(style())) }
            }
            body {
                header {
                    h1 { (document.title) }
                    @if let Some(warning) = &document.warning {
                        p.warning role="note" { (warning) }
                    }
                    @for words in &document.summary { p { (words) } }
                }
                nav aria-label="Contents" {
                    ol { @for section in &document.sections {
                        li { a href={ "#" (section.id) } { (section.title) } }
                    } }
                }
                main { @for section in sections { (section) } }
            }
        }
    };
    Ok(page.into_string())
}

fn section(section: &Section) -> Result<Markup, FigureError> {
    let parts = section.parts.iter().map(part).collect::<Result<Vec<_>, _>>()?;
    Ok(html! {
        section id=(section.id) {
            h2 { (section.title) }
            @for part in parts { (part) }
        }
    })
}

fn part(part: &Part) -> Result<Markup, FigureError> {
    Ok(match part {
        Part::Words(words) => html! { p { (words) } },
        Part::Table(shown) if shown.folded => html! {
            details { summary { "Numbers: " (shown.caption) } (table(shown)) }
        },
        Part::Table(shown) => table(shown),
        Part::Figure(figure) => picture(figure)?,
    })
}

fn picture(figure: &Figure) -> Result<Markup, FigureError> {
    let drawing = figure.inline_svg()?;
    let wide = if figure.columns > 1 { "wide" } else { "narrow" };
    Ok(html! {
        figure id=(figure.name) class=(wide) {
            (PreEscaped(drawing))
            figcaption { strong { (figure.title) } " " (figure.description) }
        }
    })
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

/// The page's style, with the figures' colours for dark mode.
fn style() -> String {
    let dark: String = Colour::ALL
        .iter()
        .map(|colour| {
            let (light, dark) = (Colour::hex(colour.light()), Colour::hex(colour.dark()));
            format!(
                "figure svg [fill=\"{light}\"]{{fill:{dark}}}\
                 figure svg [stroke=\"{light}\"]{{stroke:{dark}}}\n"
            )
        })
        .collect();
    format!("{STYLE}@media screen and (prefers-color-scheme: dark) {{\n{dark}}}\n")
}
