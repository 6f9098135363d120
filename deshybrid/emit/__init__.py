"""Texts and pictures: DOT, SVG, HTML, C, Python."""
