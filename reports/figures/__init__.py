"""Figures of the pages: one function each, arrays in, inline SVG text out."""
