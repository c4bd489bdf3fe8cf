"""Choices for options of a comparison; free of numpy, so that help texts can list them."""

from enum import StrEnum


class Averaging(StrEnum):
    """Averaging of metrics."""

    IMAGE = "image"
    """Each metric is computed per image, then averaged: every image has the same weight."""
    POOLED = "pooled"
    """Each metric is computed over the pixels of all images."""


class Alignment(StrEnum):
    """Fit of a prediction to the ground truth, per image, over the valid pixels."""

    NONE = "none"
    """Nothing: metres are compared as predicted."""
    MEDIAN = "median"
    """One factor: the ratio of the medians."""
    DEPTH = "depth"
    """Scale and shift of depth, least squares in depth."""
    DISPARITY = "disparity"
    """Scale and shift of 1/depth, least squares in 1/depth."""
