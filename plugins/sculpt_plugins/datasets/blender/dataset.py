"""A scene folder in NeRF-Synthetic layout, read whole."""

from sculpt_framework.datasets import Dataset
from sculpt_framework.posed_images.box import fit_box
from sculpt_framework.posed_images.folders import scene_folder
from sculpt_framework.posed_images.mask_polarity import white_on_object
from sculpt_framework.posed_images.outvoted import without_outvoted
from sculpt_framework.posed_images.transforms import Frame, posed_images, with_masks
from sculpt_framework.posed_images.views import load_views
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.blender.config import BlenderConfig
from sculpt_plugins.datasets.blender.transforms import read_split


class BlenderDataset(Dataset):
    def __init__(self, config: BlenderConfig, data: str):
        self.config = config
        self.folder = scene_folder(data)

    def load(self) -> Scene:
        """Everything that can be checked without decoding an image is checked first."""
        train, notes = read_split(self.folder, "train")
        test, test_notes = self._test_split()
        (train, test), mask_notes = self._masked(train, test)
        posed, test_posed, turned = white_on_object(posed_images(train), posed_images(test), "auto")
        loaded = load_views(posed, test_posed, self.config.background, downscale=self.config.downscale)
        bounds = fit_box(loaded.train)
        learned, outvoted = without_outvoted(loaded.train, bounds.box)
        if len(learned) < len(loaded.train):
            bounds = fit_box(learned)
        if len(learned) <= 2:
            count = "one view" if len(learned) == 1 else "two views"
            notes.append(f"only {count} to learn from: what they do not show is made up.")
        reference = self.folder / "gt_mesh.ply"
        return Scene(
            name=self.folder.resolve().name,
            train=tuple(learned),
            test=loaded.test,
            box=bounds.box,
            reference_mesh=reference if reference.is_file() else None,
            notes=(*notes, *test_notes, *mask_notes, *turned, *loaded.notes, *outvoted, bounds.said),
        )

    def _masked(self, train: list[Frame], test: list[Frame]) -> tuple[tuple[list[Frame], list[Frame]], list[str]]:
        frames, notes = with_masks(self.folder, [*train, *test])
        return (frames[: len(train)], frames[len(train) :]), notes

    def _test_split(self) -> tuple[list[Frame], list[str]]:
        for split in ("test", "val"):
            if (self.folder / f"transforms_{split}.json").is_file():
                frames, notes = read_split(self.folder, split, least=0)
                if split == "val":
                    notes.append("no test split: the validation views are used for measuring.")
                return frames, notes
        return [], ["no test split: nothing is measured on unseen views."]
