//! Figures: well-formed, complete, deterministic, and explicit about missing data.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use joulebus_figure::{
    Axis, Colour, Direction, Figure, FigureError, Interval, Layer, Mark, Panel, bins, tiles,
};
use proptest::prelude::*;
use roxmltree::{Document, Node};

fn panel(layers: Vec<Layer>) -> Panel {
    Panel {
        title: "a panel".to_owned(),
        x: Axis::new("time (s)"),
        y: Axis::new("power (W)"),
        layers,
    }
}

fn figure(panels: Vec<Panel>) -> Figure {
    Figure::new("a-figure", "A figure", "What is to be seen.", panels)
}

fn line(points: &[[f64; 2]], dashed: bool) -> Mark {
    Mark::Line { points: points.to_vec(), dashed }
}

fn rule(at: f64, direction: Direction) -> Mark {
    Mark::Rule { at, direction }
}

/// One panel for every kind of mark.
fn everything() -> Figure {
    use Colour::{Blue, Green, Grey, Ink, Orange, Sky, Vermilion};
    let wave: Vec<[f64; 2]> =
        (0..500).map(|i| [f64::from(i) / 30.0, (f64::from(i) / 20.0).sin()]).collect();
    let names = || ["network", "AR(5)", "persistence"].map(str::to_owned).to_vec();
    let values = |shift: f64| -> Vec<Interval> {
        let values = [0.9, 0.8, f64::NAN].map(|value| value + shift);
        let interval = |value| Interval { value, low: value - 0.05, high: value + 0.02 };
        values.map(interval).to_vec()
    };
    let dots = |shift, slot| Mark::Dots {
        values: values(shift),
        slot: [slot, 2],
        direction: Direction::Across,
    };
    let bars = Mark::Bars { values: values(0.0), slot: [0, 1], direction: Direction::Up };
    let band = wave.iter().map(|[x, y]| [*x, y - 0.2, y + 0.2]).collect();
    let heights = bins(wave.iter().map(|[_, y]| *y), [-1.0, 1.0], 20);
    let pairs = tiles(wave.iter().copied(), [0.0, 17.0], [-1.0, 1.0], 20);
    let mut panels = vec![
        panel(vec![
            Layer::plain(Sky, Mark::Stripe([2.0, 4.0])),
            Layer::named("interval", Blue, Mark::Band(band)),
            Layer::named("reading", Ink, line(&wave, false)),
            Layer::named("forecast", Orange, line(&wave[..40], true)),
            Layer::plain(Grey, rule(0.5, Direction::Across)),
        ]),
        panel(vec![
            Layer::named("density", Blue, Mark::density(&heights)),
            Layer::plain(Vermilion, rule(0.0, Direction::Up)),
        ]),
        panel(vec![
            Layer::named("pairs", Blue, Mark::Tiles(pairs)),
            Layer::named("same", Grey, Mark::Diagonal),
            Layer::named("some", Green, Mark::Points(wave[..20].to_vec())),
        ]),
        panel(vec![
            Layer::named("here", Blue, dots(0.0, 0)),
            Layer::named("paper", Vermilion, dots(0.05, 1)),
        ]),
        panel(vec![Layer::named("energy", Green, bars)]),
    ];
    panels[3].y = Axis::names("model", names());
    panels[4].x = Axis::names("model", names());
    panels[4].y = Axis::new("R²").including(0.0);
    Figure { note: Some("simulated".to_owned()), ..figure(panels) }
}

fn words<'a>(document: &'a Document<'_>) -> Vec<&'a str> {
    let nodes = document.descendants();
    let texts = nodes.filter(|node| node.has_tag_name("text"));
    let words = texts.filter_map(|node| node.text());
    words.map(str::trim).collect()
}

/// Every x and y of the drawing.
fn places(node: Node<'_, '_>) -> Vec<[f64; 2]> {
    let number = |name: &str| node.attribute(name)?.parse::<f64>().ok();
    let pair = |x: &str, y: &str| Some([number(x)?, number(y)?]);
    let listed = node.attribute("points").unwrap_or_default();
    let listed = listed.split_whitespace().map(|pair| {
        let (x, y) = pair.split_once(',').unwrap();
        [x.parse().unwrap(), y.parse().unwrap()]
    });
    let single = [("x", "y"), ("x1", "y1"), ("x2", "y2"), ("cx", "cy")];
    let single = single.map(|(x, y)| pair(x, y));
    listed.chain(single.into_iter().flatten()).collect()
}

fn check(svg: &str) {
    let document = Document::parse(svg).unwrap();
    let size = document.root_element().attribute("viewBox").unwrap();
    let size: Vec<f64> = size.split(' ').map(|length| length.parse().unwrap()).collect();
    for node in document.descendants() {
        for [x, y] in places(node) {
            let inside = (0.0..=size[2]).contains(&x) && (0.0..=size[3]).contains(&y);
            assert!(inside, "{x}, {y} of {size:?} in {node:?}");
        }
    }
}

#[test]
fn every_kind_of_mark_is_drawn_within_the_picture() {
    let svg = everything().svg().unwrap();
    check(&svg);
    let document = Document::parse(&svg).unwrap();
    for tag in ["polyline", "polygon", "rect", "circle", "text"] {
        let mut nodes = document.descendants();
        assert!(nodes.any(|node| node.has_tag_name(tag)), "{tag}");
    }
    use Colour::{Blue, Green, Orange, Sky, Vermilion};
    for colour in [Blue, Orange, Green, Vermilion, Sky] {
        let hex = Colour::hex(colour.light());
        assert!(svg.contains(&hex), "{colour:?}");
    }
    let words = words(&document);
    let texts = "(a) a panel | time (s) | power (W) | reading | persistence | simulated";
    for text in texts.split(" | ") {
        assert!(words.contains(&text), "{text}: {words:?}");
    }
}

#[test]
fn figures_have_a_text_alternative() {
    let figure = Figure { title: "R² < 1 & \"skill\"".to_owned(), ..everything() };
    let svg = figure.svg().unwrap();
    let document = Document::parse(&svg).unwrap();
    let root = document.root_element();
    assert_eq!(root.attribute("role"), Some("img"));
    for id in root.attribute("aria-labelledby").unwrap().split(' ') {
        let named = root.children().find(|node| node.attribute("id") == Some(id));
        assert!(named.unwrap().text().is_some(), "{id}");
    }
    let title = root.children().find(|node| node.has_tag_name("title"));
    assert_eq!(title.unwrap().text(), Some("R² < 1 & \"skill\""));
}

#[test]
fn panels_without_data_state_it() {
    let empty = bins([].into_iter(), [0.0, 1.0], 9);
    let marks = [
        line(&[], false),
        line(&[[f64::NAN, 1.0]], true),
        Mark::Band(vec![[0.0, f64::NAN, 1.0]]),
        Mark::Points(vec![[f64::INFINITY, 1.0]]),
        Mark::density(&empty),
        Mark::Tiles(tiles([].into_iter(), [0.0, 1.0], [0.0, 1.0], 9)),
        rule(1.0, Direction::Up),
        Mark::Diagonal,
    ];
    let layers = marks.map(|mark| vec![Layer::named("a", Colour::Blue, mark)]);
    for layers in layers.into_iter().chain([Vec::new()]) {
        let svg = figure(vec![panel(layers.clone())]).svg().unwrap();
        let document = Document::parse(&svg).unwrap();
        assert!(words(&document).contains(&"no data"), "{layers:?}");
    }
}

#[test]
fn a_gap_in_a_line_is_kept() {
    let heights = [1.0, 2.0, f64::NAN, 1.0, 2.0];
    let points: Vec<[f64; 2]> = (0..).map(f64::from).zip(heights).map(<[f64; 2]>::from).collect();
    let layer = Layer::plain(Colour::Blue, line(&points, false));
    let svg = figure(vec![panel(vec![layer])]).svg().unwrap();
    let document = Document::parse(&svg).unwrap();
    let blue = Colour::hex(Colour::Blue.light());
    let lines =
        document.descendants().filter(|node| node.attribute("stroke") == Some(&blue)).count();
    assert_eq!(lines, 2);
}

#[test]
fn the_same_data_gives_the_same_bytes() {
    assert_eq!(everything().svg().unwrap(), everything().svg().unwrap());
    assert_eq!(everything().png(1.0).unwrap(), everything().png(1.0).unwrap());
}

#[test]
fn a_png_has_its_size_and_its_text() {
    let with = everything();
    let png = with.png(1.0).unwrap();
    assert_eq!(&png[..8], b"\x89PNG\r\n\x1a\n");
    let width = u32::from_be_bytes(png[16..20].try_into().unwrap());
    assert_eq!(width, 760);
    // Text is drawn with the bundled font: without the title the pixels differ.
    let mut without = everything();
    without.panels[0].title = String::new();
    assert_ne!(png, without.png(1.0).unwrap());
    for scale in [0.0, f32::NAN, 9.0] {
        let refused = with.png(scale).unwrap_err();
        assert!(refused.to_string().contains("0.5 to 8"), "{refused}");
    }
}

#[test]
fn a_layout_out_of_range_is_refused_with_its_numbers() {
    let sound = everything();
    let changes: [fn(&mut Figure); 4] = [
        |figure| figure.panels.clear(),
        |figure| figure.columns = 0,
        |figure| figure.columns = 9,
        |figure| figure.panel_height_px = 99,
    ];
    for change in changes {
        let mut figure = sound.clone();
        change(&mut figure);
        let refused = figure.svg();
        assert!(matches!(refused, Err(FigureError::Layout { .. })), "{figure:?}");
    }
}

fn numbers() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -1e3..1e3f64,
        2 => proptest::num::f64::ANY,
        1 => Just(0.0),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_data_gives_a_well_formed_figure(
        points in proptest::collection::vec([numbers(), numbers()], 0..40),
        bands in proptest::collection::vec([numbers(), numbers(), numbers()], 0..10),
        values in proptest::collection::vec([numbers(), numbers(), numbers()], 0..5),
        label in "\\PC{0,12}|[\u{0}-\u{40}]{0,6}",
        log: [bool; 2],
        limits in proptest::option::of([numbers(), numbers()]),
    ) {
        let axis = |log: bool| if log { Axis::log(label.clone()) } else { Axis::new(label.clone()) };
        let mut lines = panel(vec![
            Layer::named(label.clone(), Colour::Blue, line(&points, false)),
            Layer::plain(Colour::Blue, line(&points, true)),
            Layer::named(label.clone(), Colour::Green, Mark::Band(bands)),
            Layer::plain(Colour::Sky, Mark::Points(points)),
            Layer::plain(Colour::Sky, Mark::Diagonal),
        ]);
        (lines.x, lines.y) = (axis(log[0]), axis(log[1]));
        if let Some([from, to]) = limits.filter(|[from, to]| from < to && from.is_finite() && to.is_finite()) {
            lines.y = lines.y.within(from, to);
        }
        let intervals: Vec<Interval> = values
            .iter()
            .map(|[value, low, high]| Interval { value: *value, low: *low, high: *high })
            .collect();
        let names = (0..intervals.len()).map(|_| label.clone()).collect();
        let mut bars = panel(vec![
            Layer::named(label.clone(), Colour::Blue, Mark::Bars {
                values: intervals.clone(), slot: [0, 2], direction: Direction::Across,
            }),
            Layer::plain(Colour::Blue, Mark::Dots {
                values: intervals, slot: [1, 2], direction: Direction::Across,
            }),
        ]);
        bars.x = Axis::new("x").including(0.0);
        bars.y = Axis::names("y", names);
        let svg = Figure { note: Some(label), ..figure(vec![lines, bars]) }.svg().unwrap();
        check(&svg);
    }
}
