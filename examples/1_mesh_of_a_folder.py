"""Photographs with cameras in, a mesh out, and how good it is.

python examples/1_mesh_of_a_folder.py --data demo --out outputs/first
"""

from pathlib import Path

import tyro

import sculpt_framework as sculpt
from sculpt_framework.evaluation.certificate import certify


def main(
    data: str = "demo", out: Path = Path("outputs/first"), method: str = "gaussian-sculpting", seconds: float = 120
) -> None:
    if out.exists() and any(out.iterdir()):
        raise SystemExit(f"{out} is not empty; give another --out.")
    scene = sculpt.load(data)
    for note in scene.notes:
        print("note:", note)
    session = sculpt.Session(scene, sculpt.methods[method](), max_time=seconds)
    mesh = session.run()
    files = session.save(out)
    seal = certify(mesh.vertices, mesh.faces)
    print(f"{len(mesh.faces)} faces, watertight: {seal.watertight}, pieces: {seal.components}")
    last = session.curve[-1]
    psnr = "none" if last["psnr"] is None else f"{last['psnr']:.1f} dB"
    print(f"held-out views: {psnr}; Chamfer distance: {last['chamfer_ps'] or 'no reference mesh'}")
    print("saved:", files["mesh"])


if __name__ == "__main__":
    tyro.cli(main)
