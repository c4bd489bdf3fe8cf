"""The pool of past fakes."""

import torch
from torch import Tensor

from depthcli.training.methods.cyclegan import ImagePool


def _image(value: float) -> Tensor:
    return torch.full((1, 1, 2, 2), float(value))


def test_fills_first_and_hands_the_same_through() -> None:
    pool = ImagePool(3)
    for value in range(3):
        assert torch.equal(pool.exchange(_image(value)), _image(value))
    assert [float(image.mean()) for image in pool.images] == [0, 1, 2]


def test_half_of_the_time_swaps_for_a_stored_one() -> None:
    torch.manual_seed(0)
    pool, swapped, seen = ImagePool(4), 0, set(range(4))
    for value in range(4):
        pool.exchange(_image(value))
    for value in range(4, 404):
        out = int(pool.exchange(_image(value)).mean())
        assert out in seen | {value}
        if out != value:
            swapped += 1
            seen = seen - {out} | {value}
        assert {int(image.mean()) for image in pool.images} == seen
    assert 160 < swapped < 240
    assert not seen & set(range(4))  # every slot is swapped, sooner or later


def test_no_pool_hands_everything_through_detached() -> None:
    image = _image(1).requires_grad_()
    for size in (0, 2):
        out = ImagePool(size).exchange(image * 2)
        assert torch.equal(out, _image(2))
        assert not out.requires_grad


def test_stored_images_are_copies_of_one_image_each() -> None:
    batch = torch.arange(2.0).view(2, 1, 1, 1).expand(2, 1, 4, 4).clone()
    pool = ImagePool(5)
    pool.exchange(batch)
    batch.fill_(9)
    assert [tuple(image.shape) for image in pool.images] == [(1, 4, 4)] * 2
    assert [float(image.mean()) for image in pool.images] == [0, 1]


def test_images_of_two_sizes_stay_among_their_own() -> None:
    torch.manual_seed(0)
    pool, wide = ImagePool(4), torch.zeros(2, 1, 2, 4)
    seen = set()
    for value in range(40):
        out = pool.exchange(torch.cat([_image(value), _image(value + 0.5)]))
        assert out.shape == (2, 1, 2, 2)
        assert pool.exchange(wide + value).shape == wide.shape
        seen.add(float(out[0].mean()) == value)
    assert seen == {True, False}
