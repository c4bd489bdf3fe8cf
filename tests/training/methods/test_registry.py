"""Each method is set as its authors set it, and refuses losses that it does not have."""

from dataclasses import replace

import pytest
from helpers.tiny_methods import tiny

from depthcli.errors import UsageError
from depthcli.training.config import LossConfig, TrainConfig
from depthcli.training.methods.registry import (
    build_method,
    check_terms,
    default_config,
    method_class,
)
from depthcli.training.methods.table import METHODS

UNPAIRED = ("cyclegan", "cut", "fastcut", "dclgan", "simdcl", "hnegsrc")
WEIGHTS = {
    "cyclegan": {"adversarial": 1, "cycle": 10, "identity": 5},
    "cut": {"adversarial": 1, "contrast_x": 0.5, "contrast_y": 0.5},
    "fastcut": {"adversarial": 1, "contrast_x": 10},
    "dclgan": {"adversarial": 0.5, "contrast_x": 1, "contrast_y": 1, "identity": 0.5},
    "simdcl": {
        "adversarial": 0.5,
        "contrast_x": 0.5,
        "contrast_y": 0.5,
        "identity": 0.5,
        "similarity": 10,
    },
    "hnegsrc": {"adversarial": 1, "contrast_x": 0.05, "contrast_y": 0.05, "relation": 0.05},
    "proposed": {
        "adversarial": 1,
        "contrast_x": 0.5,
        "contrast_y": 0.5,
        "identity": 5,
        "cycle": 10,
        "l1": 10,
    },
}
SCHEDULES = {
    "cyclegan": (100, 100, 50),
    "cut": (200, 200, 0),
    "fastcut": (150, 50, 0),
    "dclgan": (200, 200, 0),
    "simdcl": (200, 200, 0),
    "hnegsrc": (200, 200, 0),
    "proposed": (100, 100, 50),
}


@pytest.mark.parametrize("name", METHODS)
def test_weights_are_the_published_ones(name: str) -> None:
    loss = default_config(name).loss
    terms = method_class(name).TERMS
    set_here = {term: getattr(loss, term) for term in terms if getattr(loss, term)}
    assert set_here == WEIGHTS[name]
    assert loss.gan == ("hinge" if name in {"dclgan", "simdcl"} else "lsgan")
    assert loss.flip_contrast == (name == "fastcut")


@pytest.mark.parametrize("name", METHODS)
def test_the_order_of_the_half_steps_is_the_published_one(name: str) -> None:
    first = "generator" if name in {"cyclegan", "proposed"} else "discriminator"
    method = build_method(tiny(name))
    assert method.phases[0] == first
    assert method.PAIRED is (name == "proposed")
    assert sorted(method.phases) == ["discriminator", "generator"]


@pytest.mark.parametrize("name", METHODS)
def test_schedules_pools_and_pairing_are_the_published_ones(name: str) -> None:
    config = default_config(name)
    optim = config.optim
    assert (optim.epochs_constant, optim.epochs_decay, optim.pool_size) == SCHEDULES[name]
    assert (optim.learning_rate, optim.beta1, optim.beta2) == (2e-4, 0.5, 0.999)
    assert optim.batch_size == 1
    heads = (optim.head_learning_rate, optim.head_beta1, optim.head_beta2)
    assert heads == ((1e-3, 0.9, 0.999) if name == "dclgan" else (0, 0.5, 0.999))
    assert config.data.paired == (name not in UNPAIRED)
    assert config.generator.antialias == (name not in {"cyclegan", "proposed"})
    assert config.generator.residual == ("stem" if name == "proposed" else "none")


def test_the_generator_has_the_published_size() -> None:
    for name in ("cyclegan", "cut", "proposed"):
        generator = build_method(default_config(name)).generator
        assert sum(w.numel() for w in generator.parameters()) == pytest.approx(11.37e6, rel=1e-3)


@pytest.mark.parametrize("name", METHODS)
def test_a_loss_that_the_method_has_not_is_refused(name: str) -> None:
    own = set(WEIGHTS["cut" if name == "fastcut" else name])
    own |= {"gradient"} if name == "proposed" else set()
    for term in sorted({"gradient"}.union(*WEIGHTS.values())):
        loss = replace(default_config(name).loss, **{term: 2.0})
        config = replace(default_config(name), loss=loss)
        if term in own:
            check_terms(config)
            continue
        with pytest.raises(UsageError):
            check_terms(config)


@pytest.mark.parametrize("name", METHODS)
def test_a_run_without_any_loss_is_refused(name: str) -> None:
    nothing = LossConfig(0, 0, 0, 0, 0, 0, 0, 0)
    with pytest.raises(UsageError):
        build_method(replace(TrainConfig(method=name), loss=nothing))
