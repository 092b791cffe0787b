#!/usr/bin/env python3
"""Turns terminal captures with colours into an SVG picture: one, or several that follow each other.
Needs nothing but Python 3.9.

    tmux new-session -d -s view -x 120 -y 40 'target/release/joulebus demo'
    sleep 18; tmux capture-pane -t view -p -e > last; tools/ansi_svg.py last > docs/pictures/live-view.svg
    tools/ansi_svg.py --seconds 2 first second last > moving.svg

Of several, what is the same in all is drawn once. Who has asked the system for less motion sees the
last one.
"""

import argparse
import re
import unicodedata
from xml.sax.saxutils import escape

CELL_W, CELL_H, FONT_PX, PAD = 8.4, 17, 14, 14
BACKGROUND, FOREGROUND = "#11151c", "#d5dbe3"
# Normal and bright: black, red, green, yellow, blue, magenta, cyan, white.
PALETTE = [
    "#11151c", "#ff6b6b", "#6bd08b", "#f2c14e", "#6ea8fe", "#d58cf0", "#4fc7d9", "#d5dbe3",
    "#6b7685", "#ff8787", "#8ce0a5", "#f7d070", "#8dbcff", "#e2a8f7", "#76d9e8", "#ffffff",
]
ESCAPE = re.compile(r"\x1b\[([0-9;]*)m")


def indexed(code):
    """Colour of the 256-colour table."""
    if code < 16:
        return PALETTE[code]
    if code >= 232:
        level = 8 + 10 * (code - 232)
        return f"#{level:02x}{level:02x}{level:02x}"
    code -= 16
    levels = [0, 95, 135, 175, 215, 255]
    return "#%02x%02x%02x" % (levels[code // 36], levels[code // 6 % 6], levels[code % 6])


class Style:
    def __init__(self):
        self.reset()

    def reset(self):
        self.fg, self.bg, self.bold, self.reverse = None, None, False, False

    def apply(self, codes):
        codes = [int(code or 0) for code in codes.split(";")]
        while codes:
            code = codes.pop(0)
            if code == 0:
                self.reset()
            elif code == 1:
                self.bold = True
            elif code == 22:
                self.bold = False
            elif code in (7, 27):
                self.reverse = code == 7
            elif code in (38, 48):
                kind = codes.pop(0)
                if kind == 5:
                    color = indexed(codes.pop(0))
                else:
                    color = "#%02x%02x%02x" % tuple(codes.pop(0) for _ in range(3))
                if code == 38:
                    self.fg = color
                else:
                    self.bg = color
            elif code == 39:
                self.fg = None
            elif code == 49:
                self.bg = None
            elif 30 <= code <= 37 or 90 <= code <= 97:
                self.fg = PALETTE[code - 30 if code < 90 else code - 82]
            elif 40 <= code <= 47 or 100 <= code <= 107:
                self.bg = PALETTE[code - 40 if code < 100 else code - 92]

    def key(self):
        fg, bg = self.fg or FOREGROUND, self.bg
        if self.reverse:
            fg, bg = bg or BACKGROUND, fg
        return fg, bg, self.bold


def runs(line, style):
    """(column, text, style) for each stretch of one style. The style lasts over line ends."""
    column, place = 0, 0
    found = []
    for match in list(ESCAPE.finditer(line)) + [None]:
        text = line[place : match.start() if match else len(line)]
        if text:
            found.append((column, text, style.key()))
            column += sum(2 if unicodedata.east_asian_width(c) in "WF" else 1 for c in text)
        if match:
            style.apply(match.group(1))
            place = match.end()
    return found, column


def placed(text, left):
    """The x of every character but spaces, and these characters: columns stay in line in every
    browser and font, with nothing stretched and no white space to preserve."""
    glyphs, x = [], left
    for glyph in text:
        if not glyph.isspace():
            glyphs.append((f"{x:.1f}".removesuffix(".0"), glyph))
        x += CELL_W * (2 if unicodedata.east_asian_width(glyph) in "WF" else 1)
    places = " ".join(place for place, _ in glyphs)
    return f'x="{places}">{escape("".join(glyph for _, glyph in glyphs))}'


def drawn(row, found):
    """The SVG of a line."""
    out, top = [], PAD + row * CELL_H
    for column, text, (fg, bg, bold) in found:
        x, wide = PAD + column * CELL_W, len(text) * CELL_W
        if bg:
            out.append(f'<rect x="{x:.1f}" y="{top}" width="{wide:.1f}" height="{CELL_H}" fill="{bg}"/>')
        if text.strip():
            weight = ' font-weight="bold"' if bold else ""
            out.append(f'<text y="{top + 13}" fill="{fg}"{weight} {placed(text, x)}</text>')
    return "\n".join(out)


def motion(count, seconds):
    """The style that shows one group after the other."""
    if count == 1:
        return ""
    rules = ["g.f{visibility:hidden}"]
    for number in range(count):
        begin, end = 100 * number / count, 100 * (number + 1) / count
        hidden = "" if number == 0 else "0%{visibility:hidden}"
        after = "" if number == count - 1 else f"{end:.2f}%,100%{{visibility:hidden}}"
        rules.append(f"@keyframes k{number}{{{hidden}{begin:.2f}%{{visibility:visible}}{after}}}")
        rules.append(f"#f{number}{{animation:k{number} {count * seconds:g}s step-end infinite}}")
    last = f"g.f{{animation:none!important}}#f{count - 1}{{visibility:visible}}"
    rules.append(f"@media (prefers-reduced-motion:reduce){{{last}}}")
    return f"<style>{''.join(rules)}</style>"


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("captures", nargs="+")
    arguments.add_argument("--seconds", type=float, default=2, help="time that each is shown")
    given = arguments.parse_args()
    frames, width = [], 0
    for capture in given.captures:
        with open(capture, encoding="utf-8") as file:
            lines = file.read().rstrip("\n").split("\n")
        style, frame = Style(), []
        for row, line in enumerate(lines):
            found, columns = runs(line, style)
            frame.append(drawn(row, found))
            width = max(width, columns)
        frames.append(frame)
    height = max(map(len, frames))
    for frame in frames:
        frame.extend([""] * (height - len(frame)))
    w, h = width * CELL_W + 2 * PAD, height * CELL_H + 2 * PAD
    same = [len({frame[row] for frame in frames}) == 1 for row in range(height)]
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{w:.0f}" height="{h:.0f}" '
        f'viewBox="0 0 {w:.0f} {h:.0f}">{motion(len(frames), given.seconds)}',
        f'<rect width="100%" height="100%" rx="8" fill="{BACKGROUND}"/>',
        f'<g font-family="ui-monospace, \'DejaVu Sans Mono\', Menlo, Consolas, monospace" '
        f'font-size="{FONT_PX}" font-variant-ligatures="none">',
    ]
    out += [line for line, is_same in zip(frames[0], same) if is_same and line]
    if len(frames) > 1:
        for number, frame in enumerate(frames):
            changed = "\n".join(line for line, is_same in zip(frame, same) if not is_same and line)
            out.append(f'<g class="f" id="f{number}">{changed}</g>')
    out.append("</g></svg>")
    print("\n".join(out))


if __name__ == "__main__":
    main()
