"""Choices for options of training, export and evaluation; no numpy, for the help."""

from enum import StrEnum


class Weights(StrEnum):
    """Which weights of a training run make its model."""

    AVERAGED = "averaged"  #: their moving average (``optim.ema``), if there is one
    RAW = "raw"  #: those of the last step


class SplitName(StrEnum):
    """The ways to divide the labelled set of NYU Depth v2."""

    PAPER = "paper"  #: pairs 1–1000 for training, 1001–1449 for testing; no scene is in both
    OFFICIAL = "official"  #: the data set's own 795 / 654 pairs, as in most of the literature
    VAL = "val"  #: pairs 1–1000 only: every seventh scene for testing, the others for training


class Part(StrEnum):
    """What a table of scores is broken down by."""

    DISTANCE = "distance"  #: true depth
    SCENE = "scene"  #: kind of scene
    IMAGE = "image"  #: the worst images


class Tracker(StrEnum):
    """A tool that follows training runs; the name of the extra that installs it."""

    TENSORBOARD = "tensorboard"
    WANDB = "wandb"
    MLFLOW = "mlflow"


class Averaging(StrEnum):
    """Averaging of metrics."""

    IMAGE = "image"  #: each metric is computed per image, then averaged
    POOLED = "pooled"  #: each metric is computed over the pixels of all images


class Alignment(StrEnum):
    """Fit of a prediction to the ground truth, per image, over the valid pixels."""

    NONE = "none"  #: nothing: metres are compared as predicted
    MEDIAN = "median"  #: one factor: the ratio of the medians
    DEPTH = "depth"  #: scale and shift of depth, least squares in depth
    DISPARITY = "disparity"  #: scale and shift of 1/depth, least squares in 1/depth


class Crop(StrEnum):
    """The part of the frame that is evaluated."""

    NONE = "none"  #: the full frame
    EIGEN = "eigen"  #: rows 45 to 470 and columns 41 to 600 of 480×640
    S2D = "s2d"  #: 304×228 pixels in the middle of 320×240, as in papers on depth completion
    GARG = "garg"  #: the lower and middle part of KITTI's images, at any size


class Mask(StrEnum):
    """The pixels that have ground truth in an evaluation."""

    FILLED = "filled"  #: all of the in-filled depth
    RAW = "raw"  #: only where the sensor measured: raw depth > 0
