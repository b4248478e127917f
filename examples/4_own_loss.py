"""A loss of one's own, without a package: the surface is drawn towards the plane z = 0.

    python examples/4_own_loss.py --weight 0.3

A loss that others should find by name is a small package: docs/guide/writing-a-plugin.md.
"""

from dataclasses import dataclass, replace

import tyro
from jaxtyping import Float
from torch import Tensor

import sculpt_framework as sculpt
from sculpt_framework.config import LossConfig
from sculpt_framework.extractors import Extraction
from sculpt_framework.losses import GeometryLoss


class Flatness(GeometryLoss):
    """Mean square of the vertices' heights, in object units squared."""

    def __call__(self, extraction: Extraction) -> Float[Tensor, ""]:
        return extraction.surface.vertices[:, 2].square().mean()


@dataclass(frozen=True, kw_only=True)
class FlatnessConfig(LossConfig):
    """What is high costs."""

    weight: float = 0.3
    """Relative to the photometric loss."""

    def build(self) -> Flatness:
        return Flatness()


def main(data: str = "demo", method: str = "gaussian-sculpting", weight: float = 0.3, seconds: float = 40) -> None:
    scene = sculpt.load(data)
    plain = sculpt.methods[method]()
    flattened = replace(plain, losses=(*plain.losses, FlatnessConfig(weight=weight)))
    for name, config in (("without", plain), ("with", flattened)):
        mesh = sculpt.Session(scene, config, max_time=seconds).run()
        print(f"{name} the loss: {mesh.vertices[:, 2].max() - mesh.vertices[:, 2].min():.4f} high")


if __name__ == "__main__":
    tyro.cli(main)
