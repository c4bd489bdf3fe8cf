"""Checking the installation.

No package is imported before its own check, so that a broken package is reported as well.
"""

from collections.abc import Callable, Iterator

from depthcli.errors import DepthcliError
from depthcli.jobs.doctor_packages import (
    Check,
    check_conflicts,
    check_modules,
    check_versions,
    one_line_reason,
)


def check_installation(model: str | None = None, provider: str = "auto") -> Iterator[Check]:
    """Check versions, packages, a model, the providers and the codecs.

    A provider other than ``auto`` has to work; a model of None is the default model.
    """
    yield from check_versions()
    yield from check_modules()
    yield from check_conflicts()
    yield from _guarded("model", lambda: _check_model(model, provider))
    yield from _guarded("providers", lambda: _check_providers(model))
    yield from _guarded("codecs", _check_codecs)
    yield from _guarded("codec .exr", _check_openexr)
    yield from _guarded("codec .heic", _check_heif)
    yield from _guarded("video codecs", _check_video)


def _check_model(name: str | None, provider: str) -> Iterator[Check]:
    from depthcli.inference.loading import SessionLoader
    from depthcli.inference.providers import available_providers
    from depthcli.inference.runtime import ort
    from depthcli.inference.trial import try_session

    session = SessionLoader(name, provider).load()
    try_session(session)
    model = session.model
    detail = (
        f"{model.path} (sha256 {model.sha256}) runs on {session.provider}; "
        f"onnxruntime {ort.__version__} has {', '.join(available_providers())}"
    )
    found = "; ".join((detail, *session.warnings))
    yield Check("model", "warning" if session.warnings else "ok", found)


def _check_providers(name: str | None) -> Iterator[Check]:
    """Check that each available provider runs the model, except one that takes minutes."""
    from depthcli.inference.loading import SessionLoader
    from depthcli.inference.providers import SLOW_TO_START, available_providers
    from depthcli.inference.trial import try_session

    for provider in available_providers():
        title = f"provider {provider}"
        if provider == SLOW_TO_START:
            yield Check(title, "ok", "built in; builds an engine before its first run, not tried")
            continue
        try:
            try_session(SessionLoader(name, provider).load())
        except DepthcliError as error:
            yield Check(title, "warning", str(error))
        else:
            yield Check(title, "ok", "runs the model")


def _check_codecs() -> Iterator[Check]:
    from depthcli.io.images.decode import PICTURE_SUFFIXES, can_round_trip

    for suffix in PICTURE_SUFFIXES:
        works = can_round_trip(suffix)
        detail = "reads and writes" if works else "not in this OpenCV; convert such pictures"
        yield Check(f"codec {suffix}", "ok" if works else "warning", detail)


def _check_openexr() -> Iterator[Check]:
    import OpenEXR

    yield Check("codec .exr", "ok", f"OpenEXR {OpenEXR.__version__}")


def _check_heif() -> Iterator[Check]:
    from depthcli.core.extras import INSTALL_HEIF
    from depthcli.io.images.libheif import libheif_version
    from depthcli.io.listing.heif import reads_heif

    found = f"libheif {libheif_version()}" if reads_heif() else f"not read; {INSTALL_HEIF}"
    yield Check("codec .heic", "ok", found)


def _check_video() -> Iterator[Check]:
    from depthcli.errors import OutputError
    from depthcli.video.codecs import Codec, check_encoder

    for codec in Codec:
        try:
            check_encoder(codec)
        except OutputError as error:
            yield Check(f"video codec {codec}", "warning", str(error))
        else:
            yield Check(f"video codec {codec}", "ok", "writes")


def _guarded(name: str, checks: Callable[[], Iterator[Check]]) -> Iterator[Check]:
    """Report an error of the checks as a failed check, so that the other checks still run."""
    try:
        yield from checks()
    except DepthcliError as error:
        yield Check(name, "failed", str(error))
    except Exception as error:  # noqa: BLE001 - a broken package can raise anything
        yield Check(name, "failed", one_line_reason(error))
