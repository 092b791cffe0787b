//! Layout of a figure in SVG: panels, titles, legends and axes.

use plotters::chart::ChartBuilder;
use plotters::drawing::IntoDrawingArea as _;
use plotters::element::{DashedPathElement, PathElement, Rectangle};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color as _, IntoFont as _, TextStyle};
use plotters_svg::SVGBackend;

use super::paint::{Drawn, Ground, Swatch, UNITS, rgb};
use super::{Axis, Colour, Figure, FigureError, Layer, Panel, Scale};

/// Sizes in CSS pixels.
const WIDTH_PX: i32 = 760;
const NARROW_PX: i32 = 600;
const TITLE_PX: i32 = 20;
const LEGEND_ROW_PX: i32 = 17;
const NOTE_PX: i32 = 16;
const TICK_PX: i32 = 4;
const BELOW_PX: i32 = 42;
const SMALL_PX: i32 = 11;
const LABEL_PX: i32 = 12;
const SWATCH_PX: i32 = 18;
/// Text is laid out without a font. Wide common fonts need this share of their height per letter.
const LETTER: f64 = 0.6;
/// Maximum length of a legend entry and of a tick label.
const MAX_LEGEND_LETTERS: usize = 44;
const TICK_LETTERS: usize = 28;

impl Figure {
    /// The figure as a standalone SVG document on white.
    ///
    /// # Errors
    /// [`FigureError::Layout`], or an error of the drawing library.
    pub fn svg(&self) -> Result<String, FigureError> {
        document(self)
    }

    /// The figure as an SVG element within an HTML document: without a background, and without a
    /// namespace, which HTML implies.
    ///
    /// # Errors
    /// [`FigureError::Layout`], or an error of the drawing library.
    pub fn inline_svg(&self) -> Result<String, FigureError> {
        inline(self)
    }
}

fn document(figure: &Figure) -> Result<String, FigureError> {
    let body = body(figure)?;
    let (width, height) = size_px(figure);
    let head = head(figure, " xmlns=\"http://www.w3.org/2000/svg\"");
    let ground = "<rect width=\"100%\" height=\"100%\" fill=\"#FFFFFF\"/>";
    Ok(head.replacen("<svg", &format!("<svg width=\"{width}\" height=\"{height}\""), 1)
        + ground
        + "\n"
        + &body)
}

fn inline(figure: &Figure) -> Result<String, FigureError> {
    Ok(head(figure, "") + &body(figure)?)
}

/// The opening tag, with the text for screen readers.
fn head(figure: &Figure, namespace: &str) -> String {
    let (width, height) = size_px(figure);
    let (wide, high) = (width * UNITS, height * UNITS);
    let name = escaped(&figure.name);
    let (title, description) = (escaped(&figure.title), escaped(&figure.description));
    format!(
        "<svg{namespace} viewBox=\"0 0 {wide} {high}\" role=\"img\" \
         aria-labelledby=\"{name}-title {name}-desc\">\n\
         <title id=\"{name}-title\">{title}</title>\n\
         <desc id=\"{name}-desc\">{description}</desc>\n"
    )
}

/// The contents and the closing tag.
fn body(figure: &Figure) -> Result<String, FigureError> {
    let panels = figure.panels.len();
    let height_px = figure.panel_height_px;
    let sound = (1..=64).contains(&panels)
        && (1..=8).contains(&figure.columns)
        && (100..=2_000).contains(&height_px);
    if !sound {
        return Err(FigureError::Layout {
            name: figure.name.clone(),
            panels,
            columns: figure.columns,
            height_px,
        });
    }
    let (width, height) = size_px(figure);
    let mut drawn = String::new();
    {
        let size = ((width * UNITS) as u32, (height * UNITS) as u32);
        let ground = SVGBackend::with_string(&mut drawn, size).into_drawing_area();
        draw(figure, &ground).and_then(|()| ground.present()).map_err(|error| {
            FigureError::Draw { name: figure.name.clone(), reason: error.to_string() }
        })?;
    }
    // The library's opening tag is replaced by ours.
    let opening = drawn.find(">\n").map_or(0, |end| end + 2);
    Ok(drawn.split_off(opening))
}

/// Width and height in CSS pixels.
fn size_px(figure: &Figure) -> (i32, i32) {
    let width = if figure.columns > 1 { WIDTH_PX } else { NARROW_PX };
    let rows: i32 = (0..figure.panels.len().div_ceil(figure.columns.max(1)))
        .map(|row| row_px(figure, row))
        .sum();
    let note = if figure.note.is_some() { NOTE_PX } else { 0 };
    (width, rows + note)
}

fn panel_width_px(figure: &Figure) -> i32 {
    let width = if figure.columns > 1 { WIDTH_PX } else { NARROW_PX };
    width / figure.columns.max(1) as i32
}

fn row_of(figure: &Figure, row: usize) -> &[Panel] {
    let from = (row * figure.columns).min(figure.panels.len());
    let to = (from + figure.columns).min(figure.panels.len());
    &figure.panels[from..to]
}

fn row_px(figure: &Figure, row: usize) -> i32 {
    figure.panel_height_px as i32 + header_px(figure, row)
}

/// Height of the titles and legends of a row, so that its axes are aligned.
fn header_px(figure: &Figure, row: usize) -> i32 {
    let width = panel_width_px(figure);
    let panels = row_of(figure, row).iter();
    let header = panels.map(|panel| {
        let title = if panel.title.is_empty() && figure.panels.len() == 1 { 0 } else { TITLE_PX };
        title + legend_rows(panel, width).len() as i32 * LEGEND_ROW_PX
    });
    header.max().unwrap_or(0) + 4
}

fn draw(figure: &Figure, ground: &Ground<'_>) -> Drawn {
    let mut top = 0;
    let width = panel_width_px(figure);
    for row in 0..figure.panels.len().div_ceil(figure.columns) {
        let (height, header) = (row_px(figure, row), header_px(figure, row));
        for (column, panel) in row_of(figure, row).iter().enumerate() {
            let number = row * figure.columns + column;
            let letter = (figure.panels.len() > 1).then(|| letter(number));
            let left = column as i32 * width;
            let area =
                ground.clone().shrink((left * UNITS, top * UNITS), (width * UNITS, height * UNITS));
            draw_panel(&area, panel, letter, [width, height, header])?;
        }
        top += height;
    }
    if let Some(note) = &figure.note {
        let (wide, _) = ground.dim_in_pixel();
        let style = words(SMALL_PX - 1, Colour::Grey, HPos::Right, VPos::Center);
        let at = (wide as i32 - 6 * UNITS, (top + NOTE_PX / 2) * UNITS);
        text(ground, note, &style, at)?;
    }
    Ok(())
}

fn letter(number: usize) -> String {
    let letter = char::from(b'a' + (number % 26) as u8);
    format!("({letter})")
}

fn draw_panel(
    area: &Ground<'_>,
    panel: &Panel,
    letter: Option<String>,
    [width, height, header]: [i32; 3],
) -> Drawn {
    let title = [letter.unwrap_or_default(), panel.title.clone()].join(" ");
    let style = words(LABEL_PX, Colour::Ink, HPos::Left, VPos::Center);
    let title = title.trim();
    if !title.is_empty() {
        text(area, title, &style, (8 * UNITS, TITLE_PX * UNITS / 2))?;
    }
    let below_title = if title.is_empty() { 0 } else { TITLE_PX };
    draw_legend(area, panel, width, below_title)?;
    let plot = area.clone().shrink((0, header * UNITS), (width * UNITS, (height - header) * UNITS));
    draw_axes(&plot, panel, [width, height - header])
}

/// Rows of the legend: entries that fit side by side.
fn legend_rows(panel: &Panel, width: i32) -> Vec<Vec<(&Layer, i32)>> {
    let mut rows: Vec<Vec<(&Layer, i32)>> = Vec::new();
    let mut left = i32::MAX;
    for layer in &panel.layers {
        let Some(label) = &layer.label else { continue };
        let wide = SWATCH_PX + 6 + width_px(&shortened(label, MAX_LEGEND_LETTERS), SMALL_PX) + 12;
        if left.saturating_add(wide) > width - 8 {
            rows.push(Vec::new());
            left = 12;
        }
        if let Some(row) = rows.last_mut() {
            row.push((layer, left));
        }
        left += wide;
    }
    rows
}

fn draw_legend(area: &Ground<'_>, panel: &Panel, width: i32, top: i32) -> Drawn {
    let style = words(SMALL_PX, Colour::Ink, HPos::Left, VPos::Center);
    for (row, entries) in legend_rows(panel, width).iter().enumerate() {
        let middle = top + row as i32 * LEGEND_ROW_PX + LEGEND_ROW_PX / 2;
        for (layer, left) in entries {
            draw_swatch(area, layer, *left, middle)?;
            let label = shortened(layer.label.as_deref().unwrap_or_default(), MAX_LEGEND_LETTERS);
            let at = ((left + SWATCH_PX + 5) * UNITS, middle * UNITS);
            text(area, &label, &style, at)?;
        }
    }
    Ok(())
}

fn draw_swatch(area: &Ground<'_>, layer: &Layer, left: i32, middle: i32) -> Drawn {
    let colour = rgb(layer.colour);
    let (from, to, y) = (left * UNITS, (left + SWATCH_PX) * UNITS, middle * UNITS);
    let line = colour.stroke_width((UNITS as u32 * 3).div_ceil(2));
    let boxed = [(from + 3 * UNITS, y - 5 * UNITS), (to - 3 * UNITS, y + 5 * UNITS)];
    match layer.mark.swatch() {
        Swatch::Line => area.draw(&PathElement::new([(from, y), (to, y)], line)),
        Swatch::Dashes => {
            let (dash, gap) = (5 * UNITS, 3 * UNITS);
            area.draw(&DashedPathElement::new([(from, y), (to, y)], dash, gap, line))
        }
        Swatch::Dot => {
            let dot = plotters::element::Circle::new(((from + to) / 2, y), 36, colour.filled());
            area.draw(&dot)
        }
        Swatch::Box => area.draw(&Rectangle::new(boxed, colour.mix(0.8).filled())),
        Swatch::Shade => area.draw(&Rectangle::new(boxed, colour.mix(0.25).filled())),
    }
}

fn draw_axes(area: &Ground<'_>, panel: &Panel, [width, height]: [i32; 2]) -> Drawn {
    let extents: Vec<[f64; 2]> =
        panel.layers.iter().flat_map(|layer| layer.mark.extent()).collect();
    let has_data = panel.layers.iter().any(|layer| layer.mark.has_data(panel));
    let ticks = [width / 75, height / 45].map(|count| count.max(2) as usize);
    let x = panel.x.spanned(extents.iter().map(|[x, _]| *x), ticks[0]);
    let y = panel.y.spanned(extents.iter().map(|[_, y]| *y), ticks[1]);
    let (Some(mut x), Some(y), true) = (x, y, has_data) else {
        return draw_nothing(area, panel);
    };
    let mut y = y.upright();
    for (_, words) in x.ticks.iter_mut().chain(&mut y.ticks) {
        *words = shortened(words, TICK_LETTERS);
    }
    let widest = y.ticks.iter().map(|(_, text)| width_px(text, SMALL_PX)).max();
    let left = widest.unwrap_or(0) + 2 * TICK_PX + LABEL_PX + 12;
    let mut chart = ChartBuilder::on(area)
        .margin_top(6 * UNITS)
        .margin_right(14 * UNITS)
        .margin_left(4 * UNITS)
        .x_label_area_size(BELOW_PX * UNITS)
        .y_label_area_size(left * UNITS)
        .build_cartesian_2d(x, y)?;
    let small = words(SMALL_PX, Colour::Ink, HPos::Center, VPos::Center);
    let label = words(LABEL_PX, Colour::Ink, HPos::Center, VPos::Center);
    let mut mesh = chart.configure_mesh();
    mesh.bold_line_style(rgb(Colour::Faint).stroke_width(UNITS as u32))
        .light_line_style(plotters::style::TRANSPARENT)
        .axis_style(rgb(Colour::Grey).stroke_width(UNITS as u32))
        .label_style(small)
        .axis_desc_style(label)
        .set_all_tick_mark_size(TICK_PX * UNITS)
        .x_desc(clean(&panel.x.label))
        .y_desc(clean(&panel.y.label));
    if named(&panel.x) {
        mesh.disable_x_mesh();
    }
    if named(&panel.y) {
        mesh.disable_y_mesh();
    }
    mesh.draw()?;
    for layer in &panel.layers {
        layer.mark.draw(chart.plotting_area(), layer.colour, panel)?;
    }
    Ok(())
}

fn named(axis: &Axis) -> bool {
    matches!(axis.scale, Scale::Names(_))
}

/// A frame with a note that there is no data.
fn draw_nothing(area: &Ground<'_>, panel: &Panel) -> Drawn {
    let (wide, high) = area.dim_in_pixel();
    let (wide, high) = (wide as i32, high as i32);
    let inset = 30 * UNITS;
    let frame = [(inset, UNITS), (wide - inset, high - inset)];
    area.draw(&Rectangle::new(frame, rgb(Colour::Faint).stroke_width(1)))?;
    let style = words(LABEL_PX, Colour::Grey, HPos::Center, VPos::Center);
    text(area, "no data", &style, (wide / 2, (high - inset) / 2))?;
    let axes = format!("{} over {}", panel.y.label, panel.x.label);
    text(area, &axes, &style, (wide / 2, high - inset / 2))
}

fn words(size_px: i32, colour: Colour, across: HPos, down: VPos) -> TextStyle<'static> {
    // The library writes the size divided by 1.24.
    let size = f64::from(size_px * UNITS) * 1.24;
    ("sans-serif", size).into_font().color(&rgb(colour)).pos(Pos::new(across, down))
}

fn text(area: &Ground<'_>, words: &str, style: &TextStyle<'_>, at: (i32, i32)) -> Drawn {
    area.draw_text(&clean(words), style, at)
}

fn width_px(text: &str, size_px: i32) -> i32 {
    (text.chars().count() as f64 * f64::from(size_px) * LETTER).ceil() as i32
}

/// Shortens text that is too long by an ellipsis near its end: names mostly differ at their start,
/// and files by the number at their end.
fn shortened(text: &str, letters: usize) -> String {
    let text = clean(text);
    let count = text.chars().count();
    if count <= letters {
        return text;
    }
    let tail = 5.min(letters / 2);
    let head = letters - tail - 1;
    let head: String = text.chars().take(head).collect();
    let tail: String = text.chars().skip(count - tail).collect();
    format!("{head}\u{2026}{tail}")
}

/// Removes characters that XML does not allow.
fn clean(text: &str) -> String {
    let allowed = |c: &char| !c.is_control() && !matches!(c, '\u{FFFE}' | '\u{FFFF}');
    text.chars().filter(allowed).collect()
}

fn escaped(text: &str) -> String {
    clean(text)
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
