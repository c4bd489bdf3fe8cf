"""Jobs whose inputs and outputs lie in a bucket: the same bytes as from and to a folder."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.batches import images, of_plan, outputs
from helpers.requests import predict_request, video_request
from helpers.stores import Bucket, Faults
from helpers.tiny import write_image, write_model
from helpers.videos import flat_frames, write_video
from helpers.watched import Watched

from depthcli.core.camera import Intrinsics
from depthcli.errors import InputError, OutputError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import Format
from depthcli.io.listing import read_list
from depthcli.io.manifest import WHOLE, Shard, merge_manifests, read_rows, summarize
from depthcli.io.storage.paths import path_of
from depthcli.jobs.batch.plan import plan_files, plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest, dry_run
from depthcli.jobs.batch.tasks import BatchOptions
from depthcli.jobs.models import add_model
from depthcli.jobs.predict import PredictRequest, PredictResult, predict
from depthcli.jobs.video.plan import video_destination
from depthcli.jobs.video.run import video
from depthcli.models.catalog import find_model
from depthcli.video.formats import VideoFormat

FORMATS = (Format.PNG16, Format.EXR, Format.NPY, Format.PREVIEW, Format.JSON)


def test_a_table_of_cameras_comes_from_a_bucket(bucket: Bucket) -> None:
    uri = bucket.put("cameras.csv", b"id,focal_px\nhall/b,40\n")
    words = (["hall/b.png"], "the test", ".", bucket.uri("out"))
    assert plan_files(*words, cameras=uri).intrinsics == {"hall/b.png": Intrinsics(40.0)}
    with pytest.raises(UsageError):
        plan_files(*words, cameras=bucket.uri("none.csv"))


def test_images_go_from_bucket_to_bucket(
    tmp_path: Path, loader: SessionLoader, bucket: Bucket, once_each: Callable[[], Faults]
) -> None:
    image = write_image(tmp_path / "a ü.png")
    (here,) = predict(predict_request([image], f"{tmp_path}/", FORMATS, model=loader))
    assert isinstance(here, PredictResult)
    uri = bucket.put("in/a ü.png", image.read_bytes())
    faults = once_each()
    missing = bucket.uri("in/none.png")
    done, failed = predict(
        predict_request([uri, missing], bucket.uri("out/"), FORMATS, model=loader)
    )
    assert isinstance(done, PredictResult)
    assert isinstance(failed.error, InputError)
    assert str(failed.error) == f"{missing} cannot be read: no such object"
    objects = {k: v for k, v in bucket.objects().items() if k.startswith("out/")}
    assert objects == {f"out/{path.name}": path.read_bytes() for path in map(Path, here.outputs)}
    assert done.outputs == tuple(bucket.uri(f"out/{Path(name).name}") for name in here.outputs)
    assert sum(faults.seen.values()) > 2 * len(objects)  # they did fail


def test_results_lie_beside_the_object(
    tmp_path: Path, loader: SessionLoader, bucket: Bucket
) -> None:
    uri = bucket.put("in/a.png", write_image(tmp_path / "a.png").read_bytes())
    (done,) = predict(predict_request([uri], None, (Format.NPY,), model=loader))
    assert isinstance(done, PredictResult)
    assert set(bucket.objects()) == {"in/a.png", "in/a.depth.npy"}
    with pytest.raises(UsageError):
        predict(PredictRequest(("http://127.0.0.1:9/a.png",), model=loader))


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_a_sensor_s_depth_in_a_bucket_is_not_replaced(
    tmp_path: Path, loader: SessionLoader, bucket: Bucket, suffix: str
) -> None:
    image = write_image(tmp_path / "a.png").read_bytes()
    uris = tuple(bucket.put(f"in/{name}.png", image) for name in "ab")
    for number in (1, 2):
        bucket.put(f"p/p.{number:04}.png", image)
    sensor = {".png": image, ".exr": b"v/1\x01 and more"}[suffix]
    names = [bucket.put(f"{name}{suffix}", sensor) for name in ("in/a.depth", "p/d.0002")]
    problem = "exists and does not state that depthcli wrote it"
    formats = (Format.NPY, Format.PNG16, Format.EXR)
    for _ in range(2):  # its own outputs are replaced
        bad, good = predict(predict_request(uris, None, formats, model=loader))
        assert bad.error.message.problem == f"{names[0]} {problem}"
        assert isinstance(good, PredictResult)
    frames = video_request(
        bucket.uri("p/p.%04d.png"), f"{bucket.uri('p/d.%04d')}{suffix}", model=loader
    )
    with pytest.raises(OutputError, match=problem):
        video(frames)
    objects = bucket.objects()
    assert objects["in/a.depth" + suffix] == objects["p/d.0002" + suffix] == sensor
    assert not any(name.startswith("in/a.depth.npy") for name in objects)


def test_a_store_that_does_not_answer_gets_no_output(
    tmp_path: Path, loader: SessionLoader, bucket: Bucket, faults: Faults
) -> None:
    uri = bucket.put("in/a.png", write_image(tmp_path / "a.png").read_bytes())
    request = predict_request([uri], bucket.uri("out/"), (Format.PNG16,), model=loader)
    for answer, is_written in (("500 InternalError", False), ("403 AccessDenied", True)):
        faults.fault = lambda method, path, _, answer=answer: (
            answer if method == "GET" and "/out/" in path else None
        )
        (done,) = predict(request)
        assert isinstance(done, PredictResult) is is_written
        assert ("out/a.depth.png" in bucket.names()) is is_written


def test_videos_and_numbered_images_go_from_bucket_to_bucket(
    tmp_path: Path, loader: SessionLoader, bucket: Bucket, once_each: Callable[[], Faults]
) -> None:
    clip = write_video(tmp_path / "clip.avi", flat_frames([40, 120, 200]))
    formats = (VideoFormat.MKV, VideoFormat.MP4, VideoFormat.PNG16, VideoFormat.JSON)
    here = video(video_request(clip, f"{tmp_path}/here/", formats, model=loader))
    uri = bucket.put("in/clip.avi", clip.read_bytes())
    once_each()
    there = video(video_request(uri, bucket.uri("out/"), formats, model=loader))
    assert (there.name, there.problem) == (uri, None)
    assert [name.rpartition("/")[2] for name in there.outputs] == [
        Path(name).name for name in here.outputs
    ]
    assert results_in(bucket) == outputs(tmp_path / "here")
    with pytest.raises(InputError):
        video(video_request(bucket.uri("none.avi"), f"{tmp_path}/", formats, model=loader))
    damaged = bucket.put("in/bad.avi", b"no video")
    with pytest.raises(InputError):
        video(video_request(damaged, bucket.uri("out/"), formats, model=loader))
    # The frames that were written are numbered images themselves.
    plates = video_request(
        bucket.uri("plates/p.%04d.png"), bucket.uri("p/"), (VideoFormat.NPY,), model=loader
    )
    for number in (1, 2):
        bucket.put(f"plates/p.{number:04}.png", write_image(tmp_path / "p.png").read_bytes())
    assert list(video(plates).numbers) == [1, 2]
    assert len(results_in(bucket, "p/")) == 2


def test_a_video_from_a_bucket_goes_on_where_it_was_stopped(
    tmp_path: Path, loader: SessionLoader, bucket: Bucket
) -> None:
    clip = write_video(tmp_path / "clip.avi", flat_frames(range(24)))
    uri = bucket.put("in/clip.avi", clip.read_bytes())
    out = tmp_path / "out"
    formats = (VideoFormat.NPY, VideoFormat.MP4)
    request = video_request(uri, f"{out}/", formats, model=loader, workers=2)
    with pytest.raises(KeyboardInterrupt):
        video(request, Watched(last=9))
    # Not the first frames, which are predicted while the report waits for one.
    names = [f"clip.depth.{number:06}.npy" for number in range(6, 9)]
    written_ns = [(out / name).stat().st_mtime_ns for name in names]
    with pytest.raises(KeyboardInterrupt):
        video(request, Watched(last=12))
    assert [(out / name).stat().st_mtime_ns for name in names] == written_ns
    # Other content is another video.
    bucket.put("in/clip.avi", write_video(clip, flat_frames(range(9, 33))).read_bytes())
    assert video(request).frames == 24
    whole = video_destination(f"{tmp_path}/whole/", formats)
    assert video(dataclasses.replace(request, destination=whole)).frames == 24
    assert outputs(out) == outputs(tmp_path / "whole")


def batch(folder: Path, source: str, out: str, shard: Shard = WHOLE) -> BatchRequest:
    options = BatchOptions((Format.PNG16, Format.NPY))
    return of_plan(folder, plan_folder(source, out, shard=shard), options)


@pytest.fixture
def tree(tmp_path: Path, bucket: Bucket) -> dict[str, bytes]:
    """A folder with images and other things, and a copy of it in the bucket; its outputs."""
    images(tmp_path)
    clip = tmp_path / "in" / "hall" / "clip.avi"
    write_video(clip, flat_frames([40, 120, 200]))
    (tmp_path / "in" / "notes.txt").write_text("no image")
    (tmp_path / "in" / ".hidden").mkdir()
    write_image(tmp_path / "in" / ".hidden" / "a.png")
    (tmp_path / "in" / "bad.jpg").write_bytes(b"no image either")
    for path in (tmp_path / "in").rglob("*"):
        if path.is_file():
            bucket.put(f"in/{path.relative_to(tmp_path / 'in').as_posix()}", path.read_bytes())
    bucket.put("in/hall/", b"")  # as some tools mark a folder
    list(Batch(batch(tmp_path, str(tmp_path / "in"), str(tmp_path / "out"))))
    return outputs(tmp_path / "out")


def results_in(bucket: Bucket, folder: str = "out/") -> dict[str, bytes]:
    objects = bucket.objects()
    return {k.removeprefix(folder): v for k, v in objects.items() if k.startswith(folder)}


def rows(data: bytes) -> list[dict[str, object]]:
    """Rows of a manifest without what differs from run to run."""
    differing = {"seconds": 0, "error": None, "input_path": None}
    return [json.loads(line) | differing for line in data.splitlines()]


def test_a_batch_goes_from_bucket_to_bucket(
    tmp_path: Path, bucket: Bucket, tree: dict[str, bytes], once_each: Callable[[], Faults]
) -> None:
    once_each()
    job = Batch(batch(tmp_path, bucket.uri("in"), bucket.uri("in/out/")))
    assert [result.row.input for result in job] == [
        *("a.png", "bad.jpg", "z.png", "hall/b.png", "hall/clip.avi")
    ]
    assert [name for name, _ in job.tally.failures] == ["bad.jpg"]
    assert str(job.manifest) == bucket.uri("in/out/manifest.jsonl")
    files = results_in(bucket, "in/out/")
    manifest = files.pop("manifest.jsonl")
    assert files == tree
    assert rows(manifest) == rows((tmp_path / "out" / "manifest.jsonl").read_bytes())
    assert json.loads(manifest.splitlines()[0])["input_path"] == bucket.uri("in/a.png")
    # The same again keeps all but what failed, and what lies in the folder is no input.
    again = list(Batch(batch(tmp_path, bucket.uri("in"), bucket.uri("in/out/"))))
    assert [r.row.input for r in again if not r.is_kept] == ["bad.jpg"]
    assert results_in(bucket, "in/out/").keys() == files.keys() | {"manifest.jsonl"}


def test_the_requests_of_a_batch_are_those_of_the_documentation(
    tmp_path: Path, bucket: Bucket, faults: Faults
) -> None:
    image = write_image(tmp_path / "a.png").read_bytes()
    bucket.put("in/a.png", image)
    bucket.put("in/b.png", image)
    sensor = bucket.put("out/b.depth.png", image)
    again = ["GET in/a.png", "GET in/b.png", "GET out/b.depth.png", "HEAD out/b.depth.png"]
    again += ["HEAD out/a.depth.npy", "HEAD out/a.depth.png"]
    new = ["GET out/a.depth.png", "PUT out/a.depth.npy", "PUT out/a.depth.png"]
    for calls in ([*again, *new], again):
        faults.seen.clear()
        results = list(Batch(batch(tmp_path, bucket.uri("in"), bucket.uri("out"))))
        requests = [
            f"{method} {path.removeprefix(f'/{bucket.name}/')}"
            for method, path in faults.seen.elements()
        ]
        assert sorted(key for key in requests if key.endswith((".png", ".npy"))) == sorted(calls)
        errors = [result.row.error for result in results if result.row.error]
        assert len(errors) == 1
        assert str(sensor) in errors[0]
    assert bucket.objects()["out/b.depth.png"] == image


def test_a_killed_batch_goes_on(tmp_path: Path, bucket: Bucket, tree: dict[str, bytes]) -> None:
    killed = """
import os, signal, sys
from pathlib import Path
from depthcli.io import manifest
from test_remote_jobs import Batch, batch
manifest._UPLOAD_INTERVAL_S = 0
job = Batch(batch(Path(sys.argv[1]), sys.argv[2], sys.argv[3]))
for _ in range(3):
    next(job)
os.kill(os.getpid(), signal.SIGKILL)
"""
    words = [sys.executable, "-c", killed, str(tmp_path), bucket.uri("in"), bucket.uri("out")]
    here = Path(__file__).parent
    python_path = os.pathsep.join(map(str, (here, here.parent, here.parents[1])))
    done = subprocess.run(words, env={**os.environ, "PYTHONPATH": python_path}, check=False)
    assert done.returncode == -signal.SIGKILL
    left = results_in(bucket)
    assert any(name.startswith(".depthcli-batch.jsonl.") for name in left)
    assert "manifest.jsonl" not in left
    job = Batch(batch(tmp_path, bucket.uri("in"), bucket.uri("out")))
    inputs = [result.row.input for result in job if result.is_kept]
    assert {"a.png", "z.png"} <= set(inputs)
    files = results_in(bucket)
    assert rows(files.pop("manifest.jsonl"))
    assert files == tree


def test_a_model_in_a_bucket(
    tmp_path: Path, bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DEPTHCLI_MODELS", str(tmp_path / "own"))
    folder = write_model(tmp_path / "made")
    data, card = (folder / "model.onnx").read_bytes(), str(folder / "card.json")
    source = path_of(bucket.put("model.onnx", data))
    watched = Watched()
    assert add_model(source, card, progress=watched).sha256 == find_model(folder).sha256
    assert list(watched.stages.values()) == [(1, pytest.approx(len(data) / 1e6))]  # megabytes
    with pytest.raises(InputError):
        add_model(path_of(bucket.uri("none.onnx")), card, name="other")
    monkeypatch.setattr("depthcli.models.catalog.MAX_BYTES", len(data) - 1)
    with pytest.raises(InputError):
        add_model(source, card, name="other")
    assert [path.name for path in (tmp_path / "own").iterdir()] == ["tiny"]


def test_shards_become_one_manifest(tmp_path: Path, bucket: Bucket, tree: dict[str, bytes]) -> None:
    source, out = bucket.uri("in"), bucket.uri("out")
    for number in (1, 2):
        list(Batch(batch(tmp_path, source, out, Shard(number, 2))))
    assert {"manifest-1-of-2.jsonl", "manifest-2-of-2.jsonl"} <= results_in(bucket).keys()
    assert summarize(read_rows(path_of(out))).inputs == 5
    assert str(merge_manifests(path_of(out))) == f"{out}/manifest.jsonl"
    files = results_in(bucket)
    assert len(rows(files.pop("manifest.jsonl"))) == 5
    assert files == tree
    request = batch(tmp_path, source, out)
    would = {name: what for what, name, *_ in dry_run(request, request.model.load())}
    assert would == dict.fromkeys(("a.png", "z.png", "hall/b.png", "hall/clip.avi"), "keep") | {
        "bad.jpg": "fail"
    }


def test_lists_name_objects(tmp_path: Path, bucket: Bucket, tree: dict[str, bytes]) -> None:
    local = str(tmp_path / "in" / "a.png")
    words = [bucket.uri("in/z.png"), bucket.uri("in/hall/b.png"), local, "./a.png"]
    listed = bucket.put("lists/some.txt", "\n".join(words).encode())
    plan = plan_files(read_list(listed), listed, bucket.uri("in"), bucket.uri("out"))
    names = [file.name for file in plan.inputs]
    assert names == sorted(["z.png", "hall/b.png", local.lstrip("/"), "a.png"])
    assert {local, bucket.uri("in/a.png")} < {file.path for file in plan.inputs}
    plan = plan_files(words[:1], "the test", ".", str(tmp_path / "o"))
    assert [file.name for file in plan.inputs] == [f"{bucket.name}/in/z.png"]
    (result,) = Batch(of_plan(tmp_path, plan, BatchOptions((Format.NPY,))))
    assert (tmp_path / "o" / result.row.outputs[0].path).read_bytes() == tree["z.depth.npy"]
    with pytest.raises(UsageError):
        list(read_list(bucket.uri("none.txt")))


def test_listed_bad_uris_fail_alone(tmp_path: Path, bucket: Bucket, loader: SessionLoader) -> None:
    words = [bucket.put("a.png", write_image(tmp_path / "a.png").read_bytes())]
    words += [bucket.put(key, b"") for key in ("in//b.png", "in/./c.mp4", "in//d.depth.png")]
    words.append("hdfs://x/y.jpg")
    plan = plan_files(words, "the test", None, str(tmp_path / "out"))
    request = BatchRequest(plan, BatchOptions((Format.PNG16,)), loader)
    assert [what for what, *_ in dry_run(request, request.model.load())].count("fail") == 4
    rows = [result.row for result in Batch(request)]
    assert [row.input_path for row in rows if not row.error] == words[:1]
    assert {row.input_path for row in rows if row.error} == set(words[1:])
