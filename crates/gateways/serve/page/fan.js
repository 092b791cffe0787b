// A line with a band and axes: the energy ahead, and the charge along a trip.

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 400;
const HEIGHT = 90;

/** Ticks of an axis at round steps, from the first in a range on: about `count` of them. */
export function ticks(least, most, count = 3) {
  const rough = (most - least) / count;
  if (!(rough > 0 && Number.isFinite(rough))) return [];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough);
  const first = Math.ceil(least / step - 1e-9);
  const number = Math.floor(most / step + 1e-9) - first + 1;
  return Array.from({ length: number }, (_, at) => Number(((first + at) * step).toPrecision(6)));
}

const text = (points) => points.map((point) => point.map((value) => value.toFixed(1)).join(",")).join(" ");

export class Fan {
  constructor(box) {
    this.box = box;
    box.classList.add("chart", "low", "fan");
    box.setAttribute("role", "img");
    const shape = (kind) => document.createElementNS(SVG, kind);
    this.svg = shape("svg");
    this.svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
    this.svg.setAttribute("preserveAspectRatio", "none");
    this.svg.setAttribute("aria-hidden", "true");
    [this.band, this.line] = [shape("polygon"), shape("polyline")];
    this.svg.append(this.band, this.line);
    this.clear("no values yet");
  }

  /**
   * Draws points `[x, y]` of a line and of a band's outline. Axes have a least and a greatest value,
   * and ticks: pairs of a value and its label.
   */
  show({ line, band, x, y, label }) {
    const place = (value, [least, most]) => (value - least) / (most - least);
    const put = (points) => text(points.map((point) => [
      WIDTH * place(point[0], x.range), HEIGHT * (1 - place(point[1], y.range)),
    ]));
    this.line.setAttribute("points", put(line));
    this.band.setAttribute("points", put(band));
    const tick = (axis, side) => ([value, name]) => {
      const span = Object.assign(document.createElement("span"), { className: side, textContent: name });
      span.style.setProperty("--at", `${(100 * place(value, axis.range)).toFixed(1)}%`);
      span.ariaHidden = "true";
      return span;
    };
    this.box.replaceChildren(this.svg, ...x.ticks.map(tick(x, "x")), ...y.ticks.map(tick(y, "y")));
    this.box.ariaLabel = label;
  }

  clear(label) {
    this.line.removeAttribute("points");
    this.band.removeAttribute("points");
    this.box.replaceChildren(this.svg);
    this.box.ariaLabel = label;
  }
}
