"""Similarity of domains against plain loops."""

import pytest
from helpers.vectors import unit_vectors

from depthcli.training.losses import similarity


def test_is_its_formula() -> None:
    real_x, fake_x, real_y, fake_y = (unit_vectors(i)[:, 0] for i in range(4))
    wanted = 0.0
    for real, fake in ((real_x, fake_x), (real_y, fake_y)):
        pairs = list(zip(real.flatten().tolist(), fake.flatten().tolist(), strict=True))
        wanted += sum(abs(r - f) for r, f in pairs) / len(pairs)
    found = similarity(real_x=real_x, fake_x=fake_x, real_y=real_y, fake_y=fake_y)
    assert found.item() == pytest.approx(wanted, rel=1e-5)
