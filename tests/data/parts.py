"""Batches compared, tensor by tensor."""

import dataclasses

import torch

from playlearn.batch import Batch


def fields(batch: Batch) -> dict[str, torch.Tensor]:
    flat: dict[str, torch.Tensor] = {}
    for entry in dataclasses.fields(batch):
        value = getattr(batch, entry.name)
        flat |= {f"{entry.name}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {entry.name: value}
    return flat


def equal(one: Batch, other: Batch) -> bool:
    mine, its = fields(one), fields(other)
    return mine.keys() == its.keys() and all(torch.equal(mine[key], its[key]) for key in mine)
