"""Images predicted by the job itself, as a program calls it."""

import errno
import subprocess
import sys
from io import BufferedWriter, BytesIO
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import unmeasured
from helpers.requests import predict_request
from helpers.tiny import write_image, write_model

from depthcli.core.camera import Anchor
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import InputError, ModelError, OutputError
from depthcli.inference.loading import SessionLoader
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.jobs.batch.plan import plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.tasks import BatchOptions
from depthcli.jobs.image import FailedInput, write_output
from depthcli.jobs.predict import PredictRequest, predict


def test_every_image_has_its_result_in_its_turn(
    tmp_path: Path, loader: SessionLoader, capfd: pytest.CaptureFixture[str]
) -> None:
    names = [str(write_image(tmp_path / name)) for name in ("a.png", "b.png")]
    damaged = tmp_path / "damaged.png"
    damaged.write_bytes(b"no image")
    images = (names[0], str(damaged), "", names[1])
    results = predict(predict_request(images, None, (Format.NPY,), model=loader))
    first = next(results)
    assert first.outputs == (str(tmp_path / "a.depth.npy"),)
    assert (first.provider, first.warnings) == ("cpu", ())
    assert not (tmp_path / "b.depth.npy").exists()
    *failed, last = results
    assert all(isinstance(one, FailedInput) and isinstance(one.error, InputError) for one in failed)
    assert [one.name for one in (*failed, last)] == list(images[1:])
    np.testing.assert_array_equal(
        read_stored_depth(tmp_path / "b.depth.npy").displayed, first.depth
    )
    assert capfd.readouterr() == ("", "")


def test_an_image_is_out_when_its_result_is_there(tmp_path: Path, loader: SessionLoader) -> None:
    name = str(write_image(tmp_path / "a.png"))
    passed = BytesIO()
    stream = BufferedWriter(passed, 1_000_000)
    next(predict(predict_request([name], "-", model=loader, stdout=stream)))
    assert passed.getvalue().endswith(b"IEND\xaeB`\x82")


def test_formats_that_assume_a_camera_warn_once(tmp_path: Path, loader: SessionLoader) -> None:
    name = str(write_image(tmp_path / "in" / "a.png"))
    formats = (Format.NORMALS, Format.PLY)
    done = next(predict(predict_request([name], None, formats, model=loader)))
    plan = plan_folder(str(tmp_path / "in"), str(tmp_path / "out"))
    (result,) = Batch(BatchRequest(plan, BatchOptions(formats), loader))
    assert result.row.warnings == done.warnings
    (warning,) = done.warnings
    assert warning.startswith("no focal length is known")


class Broken(BytesIO):
    """A stream that fails."""

    def __init__(self, error: BaseException) -> None:
        super().__init__()
        self.error = error

    def read(self, *_: object) -> bytes:
        raise self.error

    def write(self, *_: object) -> int:
        raise self.error


@pytest.mark.parametrize("error", [OSError(errno.EIO, "Input or output error"), MemoryError()])
def test_a_failed_stream_is_a_line(tmp_path: Path, loader: SessionLoader, error: Exception) -> None:
    request = predict_request(["-"], tmp_path / "d.png", model=loader, stdin=Broken(error))
    (failed,) = predict(request)
    assert isinstance(failed.error, InputError)
    if isinstance(error, OSError):
        name = str(write_image(tmp_path / "a.png"))
        (failed,) = predict(predict_request([name], "-", model=loader, stdout=Broken(error)))
        assert isinstance(failed.error, OutputError)


def test_a_request_is_made_before_anything_heavy_is_loaded() -> None:
    code = "import sys, depthcli.jobs.predict, depthcli.jobs.predict; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    modules = set(done.stdout.decode().split())
    assert not modules & {"numpy", "cv2", "onnxruntime", "typer", "rich"}


def test_one_image_loads_nothing_that_others_need(tmp_path: Path) -> None:
    words = str(write_image(tmp_path / "a.png")), "--model", str(write_model(tmp_path / "model"))
    code = (
        "import sys; from depthcli.cli.shell import run; code = run(['predict', *sys.argv[1:]]);"
        "print(*sys.modules); sys.exit(code)"
    )
    command = [sys.executable, "-c", code, *words]
    done = subprocess.run(command, capture_output=True, check=True, env=unmeasured())
    loaded = set(done.stdout.decode().split())
    assert {"cv2", "onnxruntime", "depthcli.io.formats.raster"} <= loaded
    of_others = {"av", "sqlite3", "tempfile", "random", "rich", "torch", "pyarrow", "obstore"}
    of_others |= {"concurrent.futures", "importlib.metadata"}
    assert not loaded & (of_others | {"OpenEXR", "PIL", "numpy.ma", "multiprocessing", "ssl"})
    assert "depthcli.inference.tiles" not in loaded


def test_a_model_that_is_not_there_ends_it(tmp_path: Path) -> None:
    missing = SessionLoader(tmp_path / "missing")
    results = predict(PredictRequest((str(tmp_path / "no.png"),), model=missing))
    assert isinstance(next(results), FailedInput)
    with pytest.raises(ModelError):
        next(results)


def test_anchors_that_miss_an_image_fail_it_alone(tmp_path: Path, loader: SessionLoader) -> None:
    small = write_image(tmp_path / "small.png", np.full((8, 8, 3), 99, np.uint8))
    large = write_image(tmp_path / "large.png")
    anchors = (Anchor(40, 30, 2.0),)
    request = predict_request([small, large], None, (Format.NPY,), model=loader, anchors=anchors)
    failed, done = predict(request)
    assert isinstance(failed, FailedInput)
    assert done.depth.values[30, 40] == pytest.approx(2)


def test_depth_without_a_valid_pixel_is_not_written(tmp_path: Path) -> None:
    frame = Frame(np.zeros((4, 6, 3), np.uint8))
    empty = DepthMap(np.full((4, 6), np.nan, np.float32))
    path = tmp_path / "a.npy"
    with pytest.raises(OutputError):
        write_output(WriterOptions(), Format.NPY, empty, frame, path)
    assert list(tmp_path.iterdir()) == []
    values = np.full((4, 6), np.nan, np.float32)
    values[3, 5] = 1
    write_output(WriterOptions(), Format.NPY, DepthMap(values), frame, path)
    assert np.array_equal(np.load(path), values, equal_nan=True)
