//! Rasterisation of a figure.

use std::sync::Arc;

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};

use super::{Figure, FigureError};

/// DejaVu Sans 2.37 without hinting, reduced to the characters used. Its licence is in the same
/// directory.
const FONT: &[u8] = include_bytes!("../fonts/DejaVuSans-part.ttf");
const FAMILY: &str = "DejaVu Sans";

impl Figure {
    /// The figure as a PNG file, on white, with `scale` pixels per CSS pixel, 0.5 to 8.
    ///
    /// # Errors
    /// [`FigureError`].
    pub fn png(&self, scale: f32) -> Result<Vec<u8>, FigureError> {
        png(self, scale)
    }
}

fn png(figure: &Figure, scale: f32) -> Result<Vec<u8>, FigureError> {
    let failed = |reason: String| FigureError::Picture { name: figure.name.clone(), reason };
    if !(0.5..=8.0).contains(&scale) {
        return Err(failed(format!("scale {scale}, allowed: 0.5 to 8")));
    }
    let options = Options {
        fontdb: FONTS.with(Arc::clone),
        font_family: FAMILY.to_owned(),
        ..Options::default()
    };
    let tree =
        Tree::from_str(&figure.svg()?, &options).map_err(|error| failed(error.to_string()))?;
    let size = tree.size();
    let [width, height] = [size.width(), size.height()].map(|side| (side * scale).round() as u32);
    let mut pixels = Pixmap::new(width, height)
        .ok_or_else(|| failed(format!("{width} by {height} pixels are too many or none")))?;
    resvg::render(&tree, Transform::from_scale(scale, scale), &mut pixels.as_mut());
    pixels.encode_png().map_err(|error| failed(error.to_string()))
}

thread_local! {
    /// The font of all figures. Not of all threads: a child made by `fork` could find the lock
    /// taken for ever.
    static FONTS: Arc<fontdb::Database> = {
        let mut fonts = fontdb::Database::new();
        fonts.load_font_data(FONT.to_vec());
        fonts.set_sans_serif_family(FAMILY);
        Arc::new(fonts)
    };
}
