"""Blocks of an axis' control."""
