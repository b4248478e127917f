"""An object's folder, read whole."""

from sculpt_framework.datasets import Dataset
from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.box import fit_box
from sculpt_framework.posed_images.folders import contents, scene_folder
from sculpt_framework.posed_images.transforms import posed_images, read_frames
from sculpt_framework.posed_images.views import load_views
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.omniobject3d.config import OmniObject3DConfig
from sculpt_plugins.datasets.omniobject3d.scan import reference_mesh


class OmniObject3DDataset(Dataset):
    """The world is the frame of the renders: z up, the largest coordinate of the object about 1."""

    def __init__(self, config: OmniObject3DConfig, data: str):
        """``data`` is the object's folder or the folder ``render`` in it.

        Raises DataError where there is no such folder.
        """
        folder = scene_folder(data)
        inside = folder.name == "render" and (folder / "transforms.json").is_file()
        self.config = config
        self.folder = folder.absolute().parent if inside else folder

    def load(self) -> Scene:
        """Everything that can be checked without decoding an image is checked first."""
        transforms = self.folder / "render" / "transforms.json"
        if not transforms.is_file():
            raise DataError(
                f"{self.folder}: no render/transforms.json; found {contents(self.folder)}; expected an object of "
                "OmniObject3D, as blender_renders/banana/banana_001."
            )
        frames, notes = read_frames(transforms, "rendered", images="images")
        every = self.config.test_every
        if every:
            notes.append(f"every {every}th of {len(frames)} views is held out as a test view.")
        else:
            notes.append(f"no test split: all {len(frames)} views are learned from.")
        test = [frame for index, frame in enumerate(frames) if every and index % every == 0]
        train = [frame for index, frame in enumerate(frames) if not every or index % every]
        if not train:
            raise DataError(f"{transforms}: {len(frames)} views; all of them would be test views.")
        loaded = load_views(
            posed_images(train), posed_images(test), self.config.background, downscale=self.config.downscale
        )
        bounds = fit_box(loaded.train)
        reference, scan_note = reference_mesh(self.folder, transforms, bounds.box)
        return Scene(
            name=self.folder.resolve().name,
            train=loaded.train,
            test=loaded.test,
            box=bounds.box,
            reference_mesh=reference,
            notes=(*notes, *loaded.notes, bounds.said, scan_note),
        )
