"""Trial runs of a model on gray images, and telling a broken model from a bad image."""

import numpy as np

from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import ModelError
from depthcli.inference.pipeline import NETWORK_FROM, Pipeline
from depthcli.inference.session import Session
from depthcli.known.points import KnownDepth

_GRAY, _HFOV_DEG = 128, 60.0


def try_session(session: Session) -> None:
    """Run a loaded model on a gray image of its own size."""
    spec = session.model.card.input
    _predict_gray(session, spec.height, spec.width)


def try_other_size(session: Session) -> None:
    """Run a model on a wider image, if its card states that its input may have any size.

    Graphs of dynamic axes may still hold constants that suit one size, such as embeddings.
    """
    model = session.model
    spec = model.card.input
    if not spec.dynamic:
        return
    try:
        _predict_gray(session, spec.height, spec.width * 3 // 2)
    except ModelError as error:
        size = f"{spec.width} x {spec.height}"
        raise ModelError(
            f"{model.path} runs only on inputs of {size}, although its axes are dynamic",
            "set input.dynamic to false and input.fit to stretch in the card",
        ) from error


def check_network(error: Exception, session: Session) -> None:
    """Check the network after it failed on an input; it may work for the next one."""
    if isinstance(error, ModelError):
        try:
            try_session(session)
        except ModelError:
            raise error from None


def _predict_gray(session: Session, height: int, width: int) -> None:
    depth_for_trial(Pipeline(session), Frame(np.full((height, width, 3), _GRAY, np.uint8)))


def depth_for_trial(pipeline: Pipeline, frame: Frame) -> DepthMap:
    """Depth of an image; a network that needs known depth or a camera gets some."""
    needs_camera = pipeline.card.input.camera_matrix is not None
    camera = Intrinsics(hfov_deg=_HFOV_DEG) if needs_camera else UNKNOWN_CAMERA
    if pipeline.card.input.known_depth is None:
        return pipeline.predict(frame, camera).depth
    columns, rows = frame.display_size_px
    slope = np.linspace((0, 0, 1), (columns - 1, rows - 1, 2), NETWORK_FROM)
    return pipeline.predict(frame, camera, anchors=KnownDepth.of_table(slope)).depth
