"""Binary glTF 2.0: one mesh, one material, with or without a texture inside the file."""

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float32, Int64

_FLOAT, _UNSIGNED_INT = 5126, 5125
"""glTF's component types."""
_VERTEX_DATA, _INDEX_DATA = 34962, 34963
"""Its buffer targets."""
_LINEAR, _LINEAR_MIPMAP, _CLAMP = 9729, 9987, 33071
"""How a texture is sampled."""
_UNLIT = "KHR_materials_unlit"


def encode_glb(
    attributes: Mapping[str, Float32[np.ndarray, "v _"]], faces: Int64[np.ndarray, "f 3"], png: bytes | None = None
) -> bytes:
    """The file. ``attributes`` are glTF's, POSITION first, of two or three columns.

    With ``png``, the material is that picture through TEXCOORD_0, and unlit: photographs have their light in them. A
    viewer that does not know unlit materials shows it as a rough, non-metallic one, as without a picture.
    """
    arrays = [*attributes.values(), np.ascontiguousarray(faces.reshape(-1), dtype="<u4")]
    blobs = [array.tobytes() for array in arrays] + ([] if png is None else [png + b"\0" * (-len(png) % 4)])
    offsets = np.cumsum([0, *(len(blob) for blob in blobs)]).tolist()
    views: list[dict[str, Any]] = [
        {"buffer": 0, "byteOffset": offset, "byteLength": len(blob)}
        for offset, blob in zip(offsets, blobs, strict=False)
    ]
    for index, array in enumerate(arrays):
        views[index]["target"] = _INDEX_DATA if array.ndim == 1 else _VERTEX_DATA
    accessors: list[dict[str, Any]] = [
        {"bufferView": index, "componentType": _FLOAT, "count": len(array), "type": f"VEC{array.shape[1]}"}
        for index, array in enumerate(attributes.values())
    ]
    # glTF asks for the range of positions, so that viewers can frame the model before reading it.
    position = arrays[0]
    accessors[0] |= {"min": position.min(0).tolist(), "max": position.max(0).tolist()} if len(position) else {}
    count = {"bufferView": len(attributes), "componentType": _UNSIGNED_INT, "count": faces.size, "type": "SCALAR"}
    accessors.append(count)
    material: dict[str, Any] = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "gaussian-sculpting"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [_primitive(attributes)]}],
        "materials": [material],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offsets[-1]}],
    }
    if png is not None:
        views[-1]["byteLength"] = len(png)
        material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
        material["extensions"] = {_UNLIT: {}}
        sampler = {"magFilter": _LINEAR, "minFilter": _LINEAR_MIPMAP, "wrapS": _CLAMP, "wrapT": _CLAMP}
        document |= {
            "extensionsUsed": [_UNLIT],
            "textures": [{"sampler": 0, "source": 0}],
            "images": [{"bufferView": len(views) - 1, "mimeType": "image/png"}],
            "samplers": [sampler],
        }
    return _pack(document, b"".join(blobs))


def _primitive(attributes: Mapping[str, np.ndarray]) -> dict[str, Any]:
    named = {name: index for index, name in enumerate(attributes)}
    return {"attributes": named, "indices": len(attributes), "material": 0}


def _pack(document: dict[str, Any], binary: bytes) -> bytes:
    """The container: a header and two chunks, each padded to four bytes (JSON with spaces)."""
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    return b"".join(
        [
            struct.pack("<4sII", b"glTF", 2, length),
            struct.pack("<I4s", len(text), b"JSON"),
            text,
            struct.pack("<I4s", len(binary), b"BIN\0"),
            binary,
        ]
    )
