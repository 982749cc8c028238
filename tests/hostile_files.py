"""Files that mean harm or are damaged, each in a few lines: name, content, what esd must say."""

from __future__ import annotations

import base64
import gzip
import io
import json
import pickle
import struct
import zipfile

import numpy as np

TRIANGLE = "0 0 0\n1 0 0\n0 1 0\n"


def ply(body: bytes = b"", *, form: str = "binary_little_endian", vertices="3", faces="1") -> bytes:
    head = (
        f"ply\nformat {form} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {faces}\nproperty list uchar int vertex_indices\n"
        "end_header\n"
    )
    return head.encode() + body


def points(order: str = "<") -> bytes:
    return struct.pack(f"{order}9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)


def face(order: str = "<", count: int = 3) -> bytes:
    return struct.pack(f"{order}Biii", count, 0, 1, 2)


def gltf(**changes: object) -> bytes:
    data = points() + struct.pack("<3I", 0, 1, 2)
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    document: dict[str, object] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 12},
        ],
        "buffers": [{"byteLength": len(data), "uri": uri}],
    }
    return json.dumps({**document, **changes}).encode()


def glb(document: bytes, announced: int | None = None) -> bytes:
    document += b" " * (-len(document) % 4)
    size = 20 + len(document) if announced is None else announced
    chunk = struct.pack("<I4s", len(document), b"JSON") + document
    return struct.pack("<4sII", b"glTF", 2, size) + chunk


def stl(count: int, body: bytes) -> bytes:
    return bytes(80) + struct.pack("<I", count) + body


def bomb() -> bytes:
    """A zip file of a few kilobytes that unpacks to hundreds of megabytes of zeros."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", bytes(2**28))
    return content.getvalue()


def huge_zeros(count: int) -> list[dict[str, object]]:
    return [
        {"componentType": 5126, "count": count, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
    ]


def laughing_nodes(depth: int) -> list[dict[str, object]]:
    """Nodes of which each has the next one ten times: the last is there 10^depth times."""
    return [*({"children": [i + 1] * 10} for i in range(depth)), {"mesh": 0}]


NOISE = np.random.default_rng(0).bytes(4096)
GOOD_OFF = f"OFF\n3 1 0\n{TRIANGLE}3 0 1 2\n"

HOSTILE: dict[str, bytes] = {
    # what is announced is not there
    "billion_vertices.off": b"OFF\n1000000000 1 0\n0 0 0\n3 0 1 2\n",
    "billion_faces.off": f"OFF\n3 1000000000 0\n{TRIANGLE}3 0 1 2\n".encode(),
    "billion_vertices.ply": ply(points() + face(), vertices="1000000000"),
    "billion_faces.ply": ply(points() + face(), faces="1000000000"),
    "billion_ascii.ply": ply(TRIANGLE.encode(), form="ascii", vertices="1000000000"),
    "billion_faces.stl": stl(10**9, bytes(50)),
    "more_than_64_bits.off": f"OFF\n{10**30} 1 0\n{TRIANGLE}3 0 1 2\n".encode(),
    "more_than_64_bits.ply": ply(points() + face(), vertices=str(10**30)),
    "thousand_digits.off": f"OFF\n{'9' * 5000} 1 0\n{TRIANGLE}3 0 1 2\n".encode(),
    "cut_short.off": b"OFF\n3 1 0\n0 0 0\n1 0",
    "cut_short.ply": ply(points()[:20]),
    "cut_short.stl": stl(2, bytes(50)),
    "cut_short.glb": glb(gltf())[:60],
    "longer_than_itself.glb": glb(gltf(), announced=2**31),
    # counts and indices that cannot be
    "negative_count.off": f"OFF\n-3 1 0\n{TRIANGLE}3 0 1 2\n".encode(),
    "negative_count.ply": ply(points() + face(), vertices="-3"),
    "negative_list.ply": ply(points() + face(count=255)),
    "negative_index.off": f"OFF\n3 1 0\n{TRIANGLE}3 0 -1 2\n".encode(),
    "index_beyond.off": f"OFF\n3 1 0\n{TRIANGLE}3 0 1 3\n".encode(),
    "index_beyond.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n",
    "index_zero.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n",
    "index_word.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf a b c\n",
    "word_count.off": b"OFF\nmany 1 0\n",
    "word_coordinate.obj": b"v 0 0 zero\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "two_coordinates.obj": b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n",
    "uneven_rows.xyz": b"0 0 0\n1 1\n",
    "words.xyz": b"zero one two\n",
    # the wrong kind of thing
    "empty.off": b"",
    "empty.obj": b"",
    "empty.ply": b"",
    "empty.stl": b"",
    "empty.glb": b"",
    "empty.gltf": b"",
    "empty.xyz": b"",
    "noise.off": NOISE,
    "noise.obj": NOISE,
    "noise.ply": NOISE,
    "noise.stl": NOISE,
    "noise.glb": NOISE,
    "noise.gltf": NOISE,
    "noise.xyz": NOISE,
    "noise_after_head.ply": ply(NOISE),
    "zeros.off": bytes(4096),
    "wide_characters.obj": "v 0 0 0\nf 1 2 3\n".encode("utf-16"),
    "page.obj": b"<!DOCTYPE html><html><body>404</body></html>",
    "lines_only.obj": b"v 0 0 0\nv 1 0 0\nl 1 2\nf 1 2\n",
    "wrong_endian.ply": ply(points(">") + face(">")),
    "unknown_format.ply": ply(points() + face(), form="binary_middle_endian"),
    "no_end.ply": b"ply\nformat ascii 1.0\nelement vertex 3\n",
    "no_coordinates.ply": b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float q\nend_header\n1\n",
    "pickle.off": pickle.dumps({"vertices": [0]}),
    "pickle.ply": pickle.dumps({"vertices": [0]}),
    "archive.off": bomb(),
    "archive.obj": bomb(),
    "squeezed.ply": gzip.compress(bytes(2**24)),
    # bombs and traps in scenes
    "zero_accessor.gltf": gltf(accessors=huge_zeros(10**9)),
    "zero_accessor.glb": glb(gltf(accessors=huge_zeros(10**9))),
    "negative_accessor.gltf": gltf(accessors=huge_zeros(-1)),
    "laughing_nodes.gltf": gltf(nodes=laughing_nodes(9)),
    "node_circle.gltf": gltf(nodes=[{"mesh": 0, "children": [0]}]),
    "missing_mesh.gltf": gltf(nodes=[{"mesh": 7}]),
    "no_meshes.gltf": gltf(meshes=[], nodes=[]),
    "climbing_path.gltf": gltf(buffers=[{"byteLength": 48, "uri": "../outside.bin"}]),
    "absolute_path.gltf": gltf(buffers=[{"byteLength": 48, "uri": "/etc/passwd"}]),
    "far_path.gltf": gltf(buffers=[{"byteLength": 48, "uri": "http://localhost:9/a.bin"}]),
    "missing_buffer.gltf": gltf(buffers=[{"byteLength": 48, "uri": "none.bin"}]),
    "deep.gltf": b"[" * 100_000,
    "deep.glb": glb(b'{"a":' * 100_000),
    "list.gltf": b"[1, 2, 3]",
    # coordinates that no shape has
    "infinite.off": b"OFF\n3 1 0\n0 0 0\n1 0 inf\n0 1 0\n3 0 1 2\n",
    "beyond_double.off": b"OFF\n3 1 0\n0 0 0\n1e999 0 0\n0 1 0\n3 0 1 2\n",
    "no_number.obj": b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n",
}
