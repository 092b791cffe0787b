//! The files of a report, in memory.

use rayon::prelude::*;

use super::ReportError;
use super::document::Document;
use super::html::html;
use joulebus_figure::Figure;

/// Pixels of a PNG per CSS pixel: 230 dots per inch at page size.
const SCALE: f32 = 2.0;

/// A file of a report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct File {
    /// Its path below the report's directory.
    pub path: String,
    /// Its contents.
    pub bytes: Vec<u8>,
}

/// `report.html`, `report.json`, `report.txt`, and each figure as `figures/NAME.svg` and `.png`.
///
/// # Errors
/// A figure cannot be drawn.
pub fn files(document: &Document) -> Result<Vec<File>, ReportError> {
    let file = |path: &str, bytes: Vec<u8>| File { path: path.to_owned(), bytes };
    let mut files = vec![
        file("report.html", html(document)?.into_bytes()),
        file("report.json", serde_json::to_vec_pretty(document)?),
        file("report.txt", document.to_string().into_bytes()),
    ];
    let figures: Vec<&Figure> = document.figures().collect();
    let drawn = figures.par_iter().map(|figure| {
        let name = &figure.name;
        Ok([
            file(&format!("figures/{name}.svg"), figure.svg()?.into_bytes()),
            file(&format!("figures/{name}.png"), figure.png(SCALE)?),
        ])
    });
    let drawn = drawn.collect::<Result<Vec<_>, ReportError>>()?;
    files.extend(drawn.into_iter().flatten());
    Ok(files)
}
