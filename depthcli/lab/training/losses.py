"""Losses: adversarial, contrastive (NCE, hDCE, relations), similarity, and depth against truth."""

import math

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

TEMPERATURE = 0.07  #: τ of eq. 4
SCALES = 4


def generator_loss(gan: str, discriminator: nn.Module, *, real: Tensor, fake: Tensor) -> Tensor:
    """The generator's adversarial loss of images (B, 1, H, W) in [-1, 1]; a scalar.

    ``lsgan`` is mean (D(fake) − 1)² (Mao et al. 2017), ``hinge`` mean max(0, 1 − D(fake)), as in
    DCLGAN, ``ralsgan`` the other's loss, real and fake exchanged (Jolicoeur-Martineau 2018).
    """
    if gan == "ralsgan":
        return discriminator_loss(gan, discriminator, real=fake, fake=real)
    on_fake: Tensor = discriminator(fake).float()
    return F.relu(1 - on_fake).mean() if gan == "hinge" else ((on_fake - 1) ** 2).mean()


def discriminator_loss(gan: str, discriminator: nn.Module, *, real: Tensor, fake: Tensor) -> Tensor:
    """The discriminator's adversarial loss; a scalar.

    ``lsgan`` is ½(mean (D(real) − 1)² + mean D(fake)²) (eq. 5 and 6), ``hinge`` ½(mean max(0, 1 −
    D(real)) + mean max(0, 1 + D(fake))), and ``ralsgan`` ½(mean (D(real) − mean D(fake) − 1)² +
    mean (D(fake) − mean D(real) + 1)²).
    """
    on_real: Tensor = discriminator(real).float()
    on_fake: Tensor = discriminator(fake).float()
    if gan == "hinge":
        return 0.5 * (F.relu(1 - on_real).mean() + F.relu(1 + on_fake).mean())
    if gan == "lsgan":
        return 0.5 * (((on_real - 1) ** 2).mean() + (on_fake**2).mean())
    above, below = on_real - on_fake.mean() - 1, on_fake - on_real.mean() + 1
    return 0.5 * ((above**2).mean() + (below**2).mean())


def full_precision(like: Tensor) -> torch.autocast:
    """A context without autocast on a tensor's device, which would cast float32 arguments back."""
    return torch.autocast(like.device.type, enabled=False)


def patch_nce(query: Tensor, key: Tensor) -> Tensor:
    """Cross-entropy of finding each query's own key among its image's keys (Park et al. 2020).

    A scalar, fp32; chance level is ln P. Queries of the prediction and keys of the input, which are
    detached here, are unit vectors (B, P, C).
    """
    with full_precision(query):
        logits = torch.bmm(query.float(), key.detach().float().transpose(1, 2)) / TEMPERATURE
        return _patch_cross_entropy(logits)


def cfl_nce(query: Tensor, key: Tensor) -> Tensor:
    """As :func:`patch_nce`, but paired (Andonian et al. 2021): also negatives of the prediction."""
    with full_precision(query):
        query, key = query.float(), key.detach().float()
        to_truth = torch.bmm(query, key.transpose(1, 2)) / TEMPERATURE
        to_prediction = torch.bmm(query, query.detach().transpose(1, 2)) / TEMPERATURE
        itself = torch.eye(query.shape[1], dtype=torch.bool, device=query.device)
        to_prediction = to_prediction.masked_fill(itself, -torch.inf)
        return _patch_cross_entropy(torch.cat([to_truth, to_prediction], 2))


def _patch_cross_entropy(logits: Tensor) -> Tensor:
    """Cross-entropy with patch i as the target of row i; logits (B, P, at least P)."""
    batch, patches, _ = logits.shape
    target = torch.arange(patches, device=logits.device).repeat(batch)
    return F.cross_entropy(logits.flatten(0, 1), target)


def hdce(query: Tensor, key: Tensor, gamma: float) -> Tensor:
    """Mean over i of log Σ_{j≠i} exp((w_ij q_i·k_j − q_i·k_i)/τ) (Jung et al. 2022).

    Decoupled: without the positive in the sum, it has no lower bound at zero; at chance, it is
    ln(P − 1). As :func:`patch_nce`, with P at least 2; γ is that of :func:`negative_weights`.
    """
    with full_precision(query):
        query, key = query.float(), key.detach().float()
        products = torch.bmm(query, key.transpose(1, 2))
        positive = products.diagonal(dim1=1, dim2=2).unsqueeze(2)
        logits = (negative_weights(key, gamma) * products - positive) / TEMPERATURE
        return logits.masked_fill(_diagonal_mask(key), -torch.inf).logsumexp(2).mean()


def negative_weights(key: Tensor, gamma: float) -> Tensor:
    """w_ij: softmax over j ≠ i of k_i·k_j/γ, divided by its row's maximum, detached.

    Of unit vectors (B, P, C), it is (B, P, P) in [0, 1], fp32, more uniform with a larger γ.
    """
    key = key.detach()
    relations = torch.bmm(key, key.transpose(1, 2)) / gamma
    weights = relations.masked_fill(_diagonal_mask(key), -torch.inf).softmax(2)
    return weights / weights.amax(2, keepdim=True)


def _diagonal_mask(key: Tensor) -> Tensor:
    return torch.eye(key.shape[1], dtype=torch.bool, device=key.device)


def regularized_l1(
    prediction: Tensor,
    truth: Tensor,
    generator: nn.Module,
    penalty: float,
    valid_mask: Tensor | None = None,
) -> Tensor:
    """Mean |prediction − truth| + penalty · Σ‖convolution weights of the generator‖²; a scalar.

    Coded depth and mask are (B, 1, H, W); None counts all pixels. The penalty is λ of eq. 1.
    """
    if valid_mask is None:
        distance = F.l1_loss(prediction, truth)
    else:
        distance = masked_mean((prediction - truth).abs(), valid_mask)
    if not penalty:
        return distance
    return distance + penalty * torch.stack([(w**2).sum() for w in conv_weights(generator)]).sum()


def masked_mean(values: Tensor, valid_mask: Tensor) -> Tensor:
    """Mean of the values (B, 1, H, W) where ``valid_mask`` (bool, the same shape); 0 for none."""
    return (values * valid_mask).sum() / valid_mask.sum().clamp(min=1)


def conv_weights(network: nn.Module) -> list[Tensor]:
    """Kernels of every convolution, plain or transposed."""
    kinds = (nn.Conv2d, nn.ConvTranspose2d)
    return [layer.weight for layer in network.modules() if isinstance(layer, kinds)]


def gradient_loss(prediction: Tensor, truth: Tensor, valid_mask: Tensor | None = None) -> Tensor:
    """Mean over scales of mean |∂x e| + mean |∂y e|, with e = prediction − truth; a scalar.

    Coded depth is (B, 1, H, W), with H and W at least 16. Differences are those of valid pixels; a
    pixel of a coarser scale is valid if all that it covers are.
    """
    error, terms = prediction - truth, []
    for _ in range(SCALES):
        along_x = (error[..., 1:] - error[..., :-1]).abs()
        along_y = (error[..., 1:, :] - error[..., :-1, :]).abs()
        if valid_mask is None:
            terms.append(along_x.mean() + along_y.mean())
        else:
            both_x = valid_mask[..., 1:] & valid_mask[..., :-1]
            both_y = valid_mask[..., 1:, :] & valid_mask[..., :-1, :]
            terms.append(masked_mean(along_x, both_x) + masked_mean(along_y, both_y))
            valid_mask = F.avg_pool2d(valid_mask.float(), 2) == 1
        error = F.avg_pool2d(error, 2)
    return torch.stack(terms).mean()


def semantic_relation(query: Tensor, key: Tensor) -> Tensor:
    """Σ_i JSD(softmax(QQᵀ)_i ‖ softmax(KKᵀ)_i), mean over images (Jung et al. 2022); fp32.

    From zero, if all relations agree, to P ln 2. Unit vectors are as in :func:`patch_nce`.
    """
    with full_precision(query):
        ours, theirs = _log_relations(query.float()), _log_relations(key.detach().float())
        middle = torch.logaddexp(ours, theirs) - math.log(2)
        divergence = ours.exp() * (ours - middle) + theirs.exp() * (theirs - middle)
        return 0.5 * divergence.sum((1, 2)).mean()


def _log_relations(vectors: Tensor) -> Tensor:
    """Log of each patch's softmax over all patches; (B, P, C) to (B, P, P)."""
    return torch.bmm(vectors, vectors.transpose(1, 2)).log_softmax(2)


def similarity(*, real_x: Tensor, fake_x: Tensor, real_y: Tensor, fake_y: Tensor) -> Tensor:
    """Mean |m(real x) − m(fake x)| + mean |m(real y) − m(fake y)| (Han et al. 2021, SimDCL); fp32.

    All are (B, D), one unit vector per image, of a ``SimilarityMap``.
    """
    x = F.l1_loss(fake_x.float(), real_x.float())
    return x + F.l1_loss(fake_y.float(), real_y.float())
