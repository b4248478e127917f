"""Compile all Triton kernels for a GPU that need not be there, and print what of it can be read off the machine code.

    python -m tests.rasterizers.compile_kernels 80 3      compute capability, features

A program of its own, as Triton either interprets or compiles, from its import on.
"""

import json
import sys

import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource

from sculpt_framework.encodings import hash_grid_triton
from sculpt_plugins.rasterizers.triton import compositing, layout, projection, tiles

TYPES = {
    **dict.fromkeys(("count", "width", "height", "columns", "background_step"), "i32"),
    **dict.fromkeys(("resolution", "entries", "column"), "i32"),
    **dict.fromkeys(("fx", "fy", "cx", "cy", "low_x", "high_x", "low_y", "high_y", "low_pass", "alpha_max"), "fp32"),
    **dict.fromkeys(("counts", "gaussians", "first_entries", "sources", "starts", "stops"), "*i32"),
    **dict.fromkeys(("order", "ends"), "*i64"),
    "keys": "*i16",
    "seen": "*u8",
}


def compiled(kernel: triton.JITFunction, capability: int, warps: int, **constants: int) -> dict[str, object]:
    """Facts on the kernel: whether it uses matrix units."""
    signature = {name: "constexpr" if name in constants else TYPES.get(name, "*fp32") for name in kernel.arg_names}
    aligned = {
        (index,): [["tt.divisibility", 16]]
        for index, name in enumerate(kernel.arg_names)
        if signature[name].startswith("*")
    }
    source = ASTSource(fn=kernel, signature=signature, constexprs=constants, attrs=aligned)
    done = triton.compile(source, target=GPUTarget("cuda", capability, 32), options={"num_warps": warps})
    return {"matrix_units": "mma.sync" in done.asm["ptx"], "bytes": len(done.asm["cubin"])}


def main(capability: int, channels: int) -> None:
    record, sums = layout.record_width(channels), layout.sums_width(channels)
    facts = {
        "project": compiled(projection.project, capability, 4, CHANNELS=channels, RECORD=record),
        "write_entries": compiled(tiles.write_entries, capability, 4, RECORD=record),
        "composite": compiled(compositing.composite, capability, 1, CHANNELS=channels, RECORD=record),
    }
    for flag in (False, True):
        facts[f"composite_backward {flag}"] = compiled(
            compositing.composite_backward,
            capability,
            1,
            CHANNELS=channels,
            RECORD=record,
            SUMS=sums,
            WITH_DEPTH=flag,
        )
        facts[f"project_backward {flag}"] = compiled(
            projection.project_backward, capability, 4, CHANNELS=channels, SUMS=sums, WANTS_POSE=flag
        )
    for dense in (False, True):
        sizes = {"FEATURES": 4, "PADDED": 4, "DENSE": dense, "POINTS": 128}
        for name in ("encode", "differentiate_table", "differentiate_points"):
            facts[f"{name} {dense}"] = compiled(getattr(hash_grid_triton, name), capability, 4, **sizes)
    sys.stdout.write(json.dumps(facts) + "\n")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
