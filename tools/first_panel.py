#!/usr/bin/env python3
"""Extracts the first panel, the upper left quarter, from a figure of `joulebus report`, at twice its size.

    tools/first_panel.py report/figures/figure-4-time.svg > docs/pictures/forecast.svg
"""
import re
import sys

SCALE = 2.0
text = open(sys.argv[1], encoding="utf-8").read()
width, height, units_w, units_h = map(int, re.search(
    r'<svg width="(\d+)" height="(\d+)"[^>]*viewBox="0 0 (\d+) (\d+)"', text).groups())
panel_w, panel_h = width // 2, height // 2
text = text.replace(f'width="{width}" height="{height}"',
                    f'width="{panel_w * SCALE:.0f}" height="{panel_h * SCALE:.0f}"', 1)
text = text.replace(f'viewBox="0 0 {units_w} {units_h}"',
                    f'viewBox="0 0 {units_w // 2} {units_h // 2}"', 1)
sys.stdout.write(text)
