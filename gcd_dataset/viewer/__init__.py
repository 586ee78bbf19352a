"""Samples and patterns in the browser."""
