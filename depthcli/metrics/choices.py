"""What can be chosen about a comparison; free of numpy, so that help texts can list it."""

from enum import StrEnum


class Averaging(StrEnum):
    """What one vote is."""

    IMAGE = "image"
    """Each metric is computed per image, then averaged: every image counts the same."""
    POOLED = "pooled"
    """Pixels of all images are thrown together: images with more valid pixels count more."""


class Alignment(StrEnum):
    """What is fitted to the truth, per image, over the valid pixels."""

    NONE = "none"
    """Nothing: metres are compared as predicted."""
    MEDIAN = "median"
    """One factor: the ratio of the medians."""
    DEPTH = "depth"
    """Scale and shift of depth, least squares in depth."""
    DISPARITY = "disparity"
    """Scale and shift of 1/depth, least squares in 1/depth."""
