"""Jobs whose inputs and outputs lie in a bucket: the same bytes as from and to a folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tiny import write_model, write_picture

from depthcli.errors import InputError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.writers.formats import Format
from depthcli.jobs.failed import Failed
from depthcli.jobs.predict.pictures import Done
from depthcli.jobs.predict.request import PredictRequest
from depthcli.jobs.predict.run import predict

if TYPE_CHECKING:
    from collections.abc import Callable

    from stores import Bucket, Faults

FORMATS = (Format.PNG16, Format.EXR, Format.NPY, Format.PREVIEW, Format.JSON)


@pytest.fixture
def loader(tmp_path: Path) -> SessionLoader:
    return SessionLoader(write_model(tmp_path / "model"), "cpu", threads=1)


def test_pictures_go_from_bucket_to_bucket(
    tmp_path: Path, loader: SessionLoader, bucket: Bucket, once_each: Callable[[], Faults]
) -> None:
    picture = write_picture(tmp_path / "a ü.png")
    (here,) = predict(PredictRequest((str(picture),), f"{tmp_path}/", FORMATS, model=loader))
    assert isinstance(here, Done)
    uri = bucket.put("in/a ü.png", picture.read_bytes())
    bucket.put("in/a ü.jpg", b"another of that name")
    faults = once_each()
    missing = bucket.uri("in/none.png")
    done, failed = predict(
        PredictRequest((uri, missing), bucket.uri("out/"), FORMATS, model=loader)
    )
    assert isinstance(done, Done)
    assert isinstance(failed, Failed)
    assert isinstance(failed.error, InputError)
    assert str(failed.error) == f"{missing} cannot be read: no such object"
    found = {k: v for k, v in bucket.objects().items() if k.startswith("out/")}
    # The namesake keeps its suffix apart, as it would in a folder.
    assert found == {
        f"out/a ü.png{path.name.removeprefix('a ü')}": path.read_bytes()
        for path in map(Path, here.outputs)
    }
    assert done.outputs == tuple(
        bucket.uri(f"out/a ü.png{Path(name).name.removeprefix('a ü')}") for name in here.outputs
    )
    assert sum(faults.seen.values()) > 2 * len(found)  # they did fail


def test_without_output_results_lie_beside_the_object(
    tmp_path: Path, loader: SessionLoader, bucket: Bucket
) -> None:
    uri = bucket.put("in/a.png", write_picture(tmp_path / "a.png").read_bytes())
    (done,) = predict(PredictRequest((uri,), formats=(Format.NPY,), model=loader))
    assert isinstance(done, Done)
    assert set(bucket.objects()) == {"in/a.png", "in/a.depth.npy"}
    with pytest.raises(UsageError, match="is behind HTTP, where nothing is written"):
        predict(PredictRequest(("http://127.0.0.1:9/a.png",), model=loader))
