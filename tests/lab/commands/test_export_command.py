"""``depthcli export-onnx`` as a user runs it: each option reaches the model or its card."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from helpers.small import EFFICIENT, small_network, write_checkpoint
from helpers.tiny import load, synthetic_image, write_image
from onnx import TensorProto

from depthcli.cli.app import main
from depthcli.core.types import Frame
from depthcli.inference.session import Session
from depthcli.lab.export.int8 import calibration_batches
from depthcli.models.catalog import find_model

WIDE = dataclasses.replace(EFFICIENT, encoder=(16, 16, 32, 32, 32), decoder=(32, 16, 16, 16))
IMAGE = np.random.default_rng(0).uniform(-1, 1, (1, 1, 32, 48)).astype(np.float32)


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    return write_checkpoint(tmp_path / "last.ckpt", generator=WIDE)


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """A folder of images to calibrate on, with a file that is none."""
    folder = tmp_path / "images"
    for shift in range(4):
        write_image(folder / f"{shift}.png", np.roll(synthetic_image(), 9 * shift, axis=1))
    (folder / "notes.txt").write_text("no image")
    return folder


def _raw(path: Path, image: np.ndarray[Any, Any] = IMAGE) -> np.ndarray[Any, Any]:
    return Session(find_model(path), provider="cpu").run(image)


def _weights_of_type(path: Path, kind: int) -> int:
    return sum(t.data_type == kind for t in onnx.load(path).graph.initializer)


def test_the_model_lies_beside_the_checkpoint_and_is_its_network(
    checkpoint: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export-onnx", str(checkpoint)]) == 0
    path = checkpoint.with_suffix(".onnx")
    card = find_model(path).card
    assert path.with_name("last.card.json").is_file()
    with torch.no_grad():
        expected = small_network(WIDE)(torch.from_numpy(IMAGE))[:, 0].numpy()
    np.testing.assert_allclose(_raw(path), expected, atol=1e-3)
    output = capsys.readouterr().out
    assert str(path) in output
    assert str(card.sha256) in output
    assert (card.name, card.version, card.license) == ("custom", "1.0.0", "NOASSERTION")
    assert card.onnx.opset == 17
    assert main(["export-onnx", str(checkpoint.parent), "--quiet"]) == 0
    loud = path.with_name("other.ONNX")
    assert main(["export-onnx", str(checkpoint), "-o", str(loud), "-q"]) == 0
    assert loud.is_file()
    assert main(["export-onnx", str(checkpoint), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_the_card_has_what_the_options_say(tmp_path: Path) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt", hfov_deg=None)
    out = tmp_path / "models" / "room"
    words = ["--name", "room", "--model-version", "2.5.0", "--license", "CC0-1.0", "--hfov", "71.5"]
    words += ["--depth-factor", "1.03", "--focal-exponent", "0.8"]
    assert main(["export-onnx", str(checkpoint), "-o", str(out), *words, "--opset", "18"]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["card.json", "model.onnx"]
    card = find_model(out).card
    assert (card.name, card.version, card.license) == ("room", "2.5.0", "CC0-1.0")
    assert card.camera.hfov_deg == 71.5
    assert card.training["depth_factor"] == 1.03
    assert card.camera is not None
    assert card.camera.exponent == 0.8
    assert card.onnx.opset == 18
    opsets = onnx.load(out / "model.onnx").opset_import
    assert [(entry.domain, entry.version) for entry in opsets] == [("", 18)]


@pytest.mark.parametrize(
    ("options", "allowed"), [([], 1e-3), (["--fp16"], 2e-2), (["--tolerance", "0.5"], 0.5)]
)
def test_json_says_what_was_written_and_how_close_it_is(
    checkpoint: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    allowed: float,
) -> None:
    path = tmp_path / "m.onnx"
    assert main(["export-onnx", str(checkpoint), "-o", str(path), *options, "--json"]) == 0
    done = json.loads(capsys.readouterr().out)
    assert done["path"] == str(path)
    assert done["sha256"] == find_model(path).card.sha256
    assert done["bytes"] == path.stat().st_size
    assert 0 < done["mean_abs"] < done["max_abs"] <= done["tolerance"] == allowed
    assert done["cases"][0] == [1, 32, 48]
    assert len(done["cases"]) == 5
    assert bool(_weights_of_type(path, TensorProto.FLOAT16)) is ("--fp16" in options)


def test_weights_are_averaged_or_those_of_the_last_step(tmp_path: Path) -> None:
    last, average = small_network(WIDE, seed=1), small_network(WIDE, seed=2)
    checkpoint = write_checkpoint(tmp_path / "last.ckpt", last, WIDE, average)
    for options, network in (([], average), (["--weights", "raw"], last)):
        path = tmp_path / "m.onnx"
        assert main(["export-onnx", str(checkpoint), "-o", str(path), *options]) == 0
        with torch.no_grad():
            expected = network(torch.from_numpy(IMAGE))[:, 0].numpy()
        np.testing.assert_allclose(_raw(path), expected, atol=1e-3)


def test_a_difference_above_the_tolerance_is_refused(checkpoint: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    strict = ["--fp16", "--tolerance", "1e-7"]
    assert main(["export-onnx", str(checkpoint), "-o", str(out), *strict]) == 3
    assert not out.exists()


def test_int8_is_small_and_close_on_images(
    checkpoint: Path, images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, small = tmp_path / "whole.onnx", tmp_path / "small.onnx"
    assert main(["export-onnx", str(checkpoint), "-o", str(whole)]) == 0
    capsys.readouterr()
    command = ["export-onnx", str(checkpoint), "-o", str(small), "--int8", str(images), "--json"]
    assert main([*command, "--float-model", "whole"]) == 0
    assert find_model(small).card.float_model == "whole"
    done = json.loads(capsys.readouterr().out)
    assert done["tolerance"] == 0.2
    assert done["cases"] == [[1, 32, 48]]  # the card's size, at which it was calibrated
    assert _weights_of_type(small, TensorProto.INT8)
    assert small.stat().st_size < 0.6 * whole.stat().st_size
    inputs = calibration_batches(images, find_model(small).card.input)
    apart = max(float(np.abs(_raw(small, x) - _raw(whole, x)).max()) for x in inputs)
    assert apart == pytest.approx(done["max_abs"], abs=1e-4)
    float_m, int8_m = (
        load(str(path), provider="cpu").predict(Frame(synthetic_image())).depth.values
        for path in (whole, small)
    )
    assert int8_m.shape == (48, 64)
    assert 0 < np.abs(int8_m - float_m).mean() < 0.1 * np.ptp(float_m)


def test_options_that_clash_or_let_anything_pass_write_nothing(
    checkpoint: Path, images: Path, tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    path = tmp_path / "m.onnx"
    for wrong in (
        ["--int8", str(tmp_path / "empty")],
        ["--int8", str(images), "--fp16"],
        ["--float-model", "float"],
        ["--int8", str(images), "--float-model", "a/b"],
        ["--license", " "],
        *(["--tolerance", value] for value in ("nan", "inf", "-1")),
    ):
        assert main(["export-onnx", str(checkpoint), "-o", str(path), *wrong]) == 2
    assert not path.exists()
