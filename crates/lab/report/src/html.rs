//! A report as one self-contained HTML file: its tables, and its data as JSON, which uPlot draws.

use std::fmt::{self, Display, Write as _};

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
    let mut page = String::new();
    // Writing to a string cannot fail.
    let _ = write_page(&mut page, document, &data);
    Ok(page)
}

/// Text between tags or in quotes: everything that is not of this file goes through it.
struct Text<'a>(&'a str);

impl Display for Text<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for letter in self.0.chars() {
            match letter {
                '&' => out.write_str("&amp;")?,
                '<' => out.write_str("&lt;")?,
                '>' => out.write_str("&gt;")?,
                '"' => out.write_str("&quot;")?,
                letter => out.write_char(letter)?,
            }
        }
        Ok(())
    }
}

fn write_page(out: &mut String, document: &Document, data: &str) -> fmt::Result {
    let title = Text(&document.title);
    write!(
        out,
        "<!DOCTYPE html><html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <meta name=\"color-scheme\" content=\"light dark\"><title>{title}</title>\
         <style>{LIBRARY_STYLE}{STYLE}</style></head><body><header><h1>{title}</h1>"
    )?;
    if let Some(warning) = &document.warning {
        write!(out, "<p class=\"warning\" role=\"note\">{}</p>", Text(warning))?;
    }
    for words in &document.summary {
        write!(out, "<p>{}</p>", Text(words))?;
    }
    out.push_str(
        "<noscript><p class=\"warning\">The figures need JavaScript. The tables have their \
         numbers.</p></noscript></header><nav aria-label=\"Contents\"><ol>",
    );
    for section in &document.sections {
        let (id, title) = (Text(&section.id), Text(&section.title));
        write!(out, "<li><a href=\"#{id}\">{title}</a></li>")?;
    }
    out.push_str("</ol></nav><main>");
    for section in &document.sections {
        write_section(out, section)?;
    }
    write!(
        out,
        "</main><script type=\"application/json\" id=\"data\">{data}</script>\
         <script>/*\n{LIBRARY_LICENCE}*/\n{LIBRARY}</script><script>{SCRIPT}</script></body></html>"
    )
}

fn write_section(out: &mut String, section: &Section) -> fmt::Result {
    let (id, title) = (Text(&section.id), Text(&section.title));
    write!(out, "<section id=\"{id}\"><h2>{title}</h2>")?;
    for part in &section.parts {
        match part {
            Part::Words(words) => write!(out, "<p>{}</p>", Text(words))?,
            Part::Table(shown) if shown.folded => {
                let caption = Text(&shown.caption);
                write!(out, "<details><summary>Numbers: {caption}</summary>")?;
                write_table(out, shown)?;
                out.push_str("</details>");
            }
            Part::Table(shown) => write_table(out, shown)?,
            Part::Figure(drawn) => write_figure(out, drawn)?,
        }
    }
    out.push_str("</section>");
    Ok(())
}

/// A figure, whose panels the script draws.
fn write_figure(out: &mut String, figure: &Figure) -> fmt::Result {
    let (name, title) = (Text(&figure.name), Text(&figure.title));
    let description = Text(&figure.description);
    write!(
        out,
        "<figure id=\"{name}\"><div class=\"panels\"></div>\
         <figcaption><strong>{title}</strong> {description}"
    )?;
    if let Some(note) = &figure.note {
        write!(out, " <em>({})</em>", Text(note))?;
    }
    out.push_str("</figcaption></figure>");
    Ok(())
}

fn write_table(out: &mut String, table: &Table) -> fmt::Result {
    let (id, caption) = (Text(&table.id), Text(&table.caption));
    write!(
        out,
        "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"{caption}\">\
         <table id=\"{id}\"><caption>{caption}</caption><thead><tr>"
    )?;
    let class = |at: usize| match table.is_of_numbers(at) {
        true => " class=\"number\"",
        false => "",
    };
    for (at, column) in table.columns.iter().enumerate() {
        write!(out, "<th scope=\"col\"{}>{}</th>", class(at), Text(&column.title))?;
    }
    out.push_str("</tr></thead><tbody>");
    for row in &table.rows {
        out.push_str("<tr>");
        for (at, cell) in row.iter().enumerate() {
            let shown = cell.shown();
            match at {
                0 => write!(out, "<th scope=\"row\">{}</th>", Text(&shown))?,
                _ => write!(out, "<td{}>{}</td>", class(at), Text(&shown))?,
            }
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table></div>");
    Ok(())
}
