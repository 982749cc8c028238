import base64
import json

import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.io.meshes import read_arrays

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype="<f4")


def document(positions=SQUARE, indices=(0, 1, 2, 0, 2, 3), kind=5126, **primitive):
    first, second = positions.tobytes(), np.array(indices, "<u4").tobytes()
    data = first + second
    return {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, **primitive}]}],
        "accessors": [
            {"bufferView": 0, "componentType": kind, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": len(indices), "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(first)},
            {"buffer": 0, "byteOffset": len(first), "byteLength": len(second)},
        ],
        "buffers": [{"byteLength": len(data), "uri": encoded(data)}],
    }


def encoded(data: bytes) -> str:
    return "data:application/octet-stream;base64," + base64.b64encode(data).decode()


def arrays(folder, content):
    (folder / "m.gltf").write_text(json.dumps(content))
    return read_arrays(folder / "m.gltf")


@pytest.mark.parametrize(
    ("mode", "indices", "faces"),
    [
        (4, (0, 1, 2, 0, 2, 3), [[0, 1, 2], [0, 2, 3]]),
        (5, (0, 1, 3, 2), [[0, 1, 3], [3, 1, 2]]),
        (6, (0, 1, 2, 3), [[0, 1, 2], [0, 2, 3]]),
    ],
)
def test_strips_and_fans_are_triangles(tmp_path, mode, indices, faces):
    np.testing.assert_array_equal(arrays(tmp_path, document(indices=indices, mode=mode))[1], faces)


def test_normalised_integers_are_divided(tmp_path):
    content = document(np.pad(65535 * SQUARE.astype("<u2"), ((0, 0), (0, 1))), kind=5123)
    content["bufferViews"][0]["byteStride"] = 8
    content["accessors"][0]["normalized"] = True
    content["extensionsRequired"] = ["KHR_mesh_quantization"]
    np.testing.assert_array_equal(arrays(tmp_path, content)[0], SQUARE)


def test_sparse_values_replace_some(tmp_path):
    content = document()
    data = np.array([3], "<u2").tobytes() + bytes(2) + np.array([[0, 5, 0]], "<f4").tobytes()
    content["buffers"].append({"byteLength": len(data), "uri": encoded(data)})
    content["bufferViews"] += [
        {"buffer": 1, "byteLength": 2},
        {"buffer": 1, "byteOffset": 4, "byteLength": 12},
    ]
    content["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": 2, "componentType": 5123},
        "values": {"bufferView": 3},
    }
    np.testing.assert_array_equal(arrays(tmp_path, content)[0][:, 1], [0, 0, 1, 5])
    del content["accessors"][0]["bufferView"]  # of zeros, then
    np.testing.assert_array_equal(arrays(tmp_path, content)[0][:, 1], [0, 0, 0, 5])


def test_nodes_place_parts_and_reflections_keep_the_outside(tmp_path):
    content = document()
    content["nodes"] = [
        {"children": [1, 2], "translation": [10, 0, 0]},
        {"mesh": 0, "rotation": [0, 0, 2**-0.5, 2**-0.5], "scale": [2, 1, 1]},
        {"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 5, 0, 1]},
    ]
    vertices, faces = arrays(tmp_path, content)
    np.testing.assert_allclose(vertices[1], [10, 2, 0], atol=1e-12)
    np.testing.assert_allclose(vertices[5], [9, 5, 0], atol=1e-12)
    np.testing.assert_array_equal(faces[2], [6, 5, 4])


def test_names_of_files_may_be_encoded(tmp_path):
    content = document()
    data = base64.b64decode(content["buffers"][0]["uri"].split(",")[1])
    (tmp_path / "my body.bin").write_bytes(data)
    content["buffers"][0]["uri"] = "my%20body.bin"
    assert len(arrays(tmp_path, content)[1]) == 2
    (tmp_path / "my body.bin").write_bytes(data[:-1])
    with pytest.raises(InputError, match="announces 72 bytes of data and has 71"):
        arrays(tmp_path, content)
    (tmp_path / "my body.bin").unlink()
    with pytest.raises(InputError, match=r"its file 'my body.bin' is missing"):
        arrays(tmp_path, content)


def changed(change):
    content = document()
    change(content)
    return content


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (document(extensions={"KHR_draco_mesh_compression": {}}), "compressed"),
        (document() | {"extensionsUsed": ["KHR_draco_mesh_compression"]}, "KHR_draco_mesh_comp"),
        (document() | {"extensionsRequired": ["X_new"]}, "needs the extension X_new"),
        (document() | {"extensionsUsed": ["EXT_mesh_gpu_instancing"]}, "repeats parts"),
        (document(mode=1), "no triangles"),
        (document(indices=(0, 1, 7)), "names vertex 7; there are 4"),
        (changed(lambda d: d["accessors"][0].pop("bufferView")), "values without data"),
        (changed(lambda d: d["accessors"][0].update(type="VEC2")), "have 2 coordinates"),
        (changed(lambda d: d["accessors"][0].update(count=9)), "beyond the end of their data"),
        (changed(lambda d: d["bufferViews"][0].update(byteLength=999)), "lies beyond the end"),
        (
            changed(
                lambda d: d["bufferViews"][0].update(extensions={"EXT_meshopt_compression": {}})
            ),
            "compressed",
        ),
        (changed(lambda d: d["buffers"][0].update(uri="data:;base64,A")), "not base64"),
        (
            changed(lambda d: d["meshes"][0]["primitives"][0]["attributes"].update(COLOR_0=1)),
            "has 6 values for 4 vertices",
        ),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(tmp_path, content, message):
    with pytest.raises(InputError, match=rf"m.gltf': .*{message}"):
        arrays(tmp_path, content)
