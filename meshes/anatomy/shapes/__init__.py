"""Geometry of regions: outlines, closed surfaces, label images, and the conversions between them."""
