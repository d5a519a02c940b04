"""Geometry of regions: contours, closed surfaces, label images, and conversions between them."""
