"""Surfaces of VTK, as its own writers lay them out."""

import base64
import re
import zlib

import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.io.attributes import write_with_attributes
from esd.mesh.io.meshes import read_arrays
from esd.mesh.shapes import torus

MESH = torus(7, 5)
COUNT, FACES = len(MESH.vertices), len(MESH.faces)


def is_the_mesh(path):
    vertices, faces = read_arrays(path)
    np.testing.assert_allclose(vertices, MESH.vertices, atol=1e-6)  # some hold 32 bits
    np.testing.assert_array_equal(faces, MESH.faces)


def legacy(version: str, *, is_text: bool, strip: bool = False) -> bytes:
    def numbers(values, dtype):
        if is_text:
            return (" ".join(map(repr, np.ravel(values).tolist())) + "\n").encode()
        return np.ravel(values).astype(dtype).tobytes() + b"\n"

    parts = [
        f"# vtk DataFile Version {version}\ntitle\n{'ASCII' if is_text else 'BINARY'}\n",
        "DATASET POLYDATA\nFIELD FieldData 1\ntimes 1 2 double\n",
        numbers([0.5, 1.5], ">f8"),
        f"POINTS {COUNT} double\n",
        numbers(MESH.vertices, ">f8"),
        "METADATA\nINFORMATION 0\n\n",
    ]
    kind, size = ("TRIANGLE_STRIPS", 1) if strip else ("POLYGONS", FACES)
    cells = np.array([[0, 1, 2, 3, 4]]) if strip else MESH.faces
    if version >= "5":
        ends = np.arange(size + 1) * cells.shape[1]
        parts += [f"{kind} {size + 1} {cells.size}\nOFFSETS vtktypeint64\n", numbers(ends, ">i8")]
        parts += ["CONNECTIVITY vtktypeint64\n", numbers(cells, ">i8")]
    else:
        flat = np.column_stack([np.full(size, cells.shape[1]), cells])
        parts += [f"{kind} {size} {flat.size}\n", numbers(flat, ">i4")]
    parts += [f"POINT_DATA {COUNT}\nSCALARS a int 1\n"]
    return b"".join(part if isinstance(part, bytes) else part.encode() for part in parts)


@pytest.mark.parametrize("is_text", [True, False])
@pytest.mark.parametrize("version", ["3.0", "4.2", "5.1"])
def test_legacy_files_are_read(tmp_path, version, is_text):
    (tmp_path / "m.vtk").write_bytes(legacy(version, is_text=is_text))
    is_the_mesh(tmp_path / "m.vtk")
    (tmp_path / "s.vtk").write_bytes(legacy(version, is_text=is_text, strip=True))
    assert read_arrays(tmp_path / "s.vtk")[1].tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4]]


def test_polygons_of_different_sizes_are_cut(tmp_path):
    text = "# vtk DataFile Version 2.0\n\nASCII\nDATASET POLYDATA\nPOINTS 5 float\n"
    text += "0 0 0 1 0 0 1 1 0 0 1 0 2 2 0\nPOLYGONS 2 9\n4 0 1 2 3\n3 1 4 2\n"
    (tmp_path / "m.vtk").write_text(text)
    assert read_arrays(tmp_path / "m.vtk")[1].tolist() == [[0, 1, 2], [0, 2, 3], [1, 4, 2]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (f"POINTS {COUNT}", f"POINTS {10**9}", "announces 3000000000 numbers and ends before"),
        (f"POINTS {COUNT}", "POINTS 1000", "announces 3000 numbers and ends before"),
        ("double\n", "complex\n", "type 'complex', which is not read"),
        (f"POLYGONS {FACES}", f"POLYGONS {FACES - 1}", "do not fit its lists of them"),
        ("POLYGONS", "LINES", "no faces in it"),
        ("POINTS", "PLACES", "no faces in it"),
    ],
)
def test_legacy_files_that_cannot_be_used_are_refused(tmp_path, old, new, message):
    content = legacy("3.0", is_text=True).decode().replace(old, new)
    (tmp_path / "m.vtk").write_text(content)
    with pytest.raises(InputError, match=rf"m.vtk'.*{message}"):
        read_arrays(tmp_path / "m.vtk")


def test_files_whose_data_set_is_in_the_middle_of_a_line_end(tmp_path):
    content = legacy("3.0", is_text=True).replace(b"\nDATASET", b" DATASET")
    (tmp_path / "m.vtk").write_bytes(content)
    with pytest.raises(InputError, match=r"m.vtk'.*no faces in it"):
        read_arrays(tmp_path / "m.vtk")


def vtp(form: str, *, packed: bool, header: str = "UInt32", kind: str = "PolyData") -> bytes:
    """A file with its arrays inline (`ascii`, `binary`) or appended (`raw`, `base64`)."""
    head_type = {"UInt32": "<u4", "UInt64": "<u8"}[header]
    appended, data = b"", {}

    def block(values) -> bytes:
        content = values.tobytes()
        if not packed:
            head = np.array([len(content)], head_type).tobytes()
            return head + content if form == "raw" else base64.b64encode(head + content)
        blocks = [content[i : i + 300] for i in range(0, len(content), 300)]
        small = [zlib.compress(part) for part in blocks]
        sizes = [len(small), 300, len(blocks[-1]) % 300, *map(len, small)]
        head, body = np.array(sizes, head_type).tobytes(), b"".join(small)
        return head + body if form == "raw" else base64.b64encode(head) + base64.b64encode(body)

    for name, values in (
        ("Points", MESH.vertices.astype("<f4")),
        ("connectivity", MESH.faces.astype("<i8")),
        ("offsets", 3 * np.arange(1, FACES + 1, dtype="<i8")),
    ):
        kinds = 'type="Float32" NumberOfComponents="3"' if name == "Points" else 'type="Int64"'
        start = f'<DataArray {kinds} Name="{name}" '
        if form in ("raw", "base64"):
            data[name] = start + f'format="appended" offset="{len(appended)}"/>'
            appended += block(values)
        else:
            text = " ".join(map(repr, values.ravel().tolist()))
            text = text if form == "ascii" else block(values).decode()
            data[name] = start + f'format="{form}">{text}</DataArray>'
    compressor = ' compressor="vtkZLibDataCompressor"' if packed else ""
    text = (
        f'<?xml version="1.0"?><VTKFile type="{kind}" byte_order="LittleEndian" '
        f'header_type="{header}"{compressor}><PolyData><Piece>'
        f"<Points>{data['Points']}</Points>"
        f"<Polys>{data['connectivity']}{data['offsets']}</Polys></Piece></PolyData>"
    ).encode()
    if appended:
        text += f'<AppendedData encoding="{form}">_'.encode() + appended + b"</AppendedData>"
    return text + b"</VTKFile>"


@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
@pytest.mark.parametrize("packed", [True, False])
@pytest.mark.parametrize("form", ["ascii", "binary", "raw", "base64"])
def test_xml_files_are_read(tmp_path, form, packed, header):
    (tmp_path / "m.vtp").write_bytes(vtp(form, packed=packed, header=header))
    is_the_mesh(tmp_path / "m.vtp")


def test_what_we_write_and_several_pieces_are_read(tmp_path):
    write_with_attributes(MESH, {"a": np.zeros(COUNT)}, tmp_path / "m.vtp")
    is_the_mesh(tmp_path / "m.vtp")
    text = (tmp_path / "m.vtp").read_text()
    start, end = text.index("<Piece"), text.index("</Piece>") + len("</Piece>")
    (tmp_path / "two.vtp").write_text(text[:end] + text[start:end] + text[end:])
    vertices, faces = read_arrays(tmp_path / "two.vtp")
    assert len(vertices) == 2 * COUNT
    np.testing.assert_array_equal(faces[FACES:], MESH.faces + COUNT)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"hello", "is no XML"),
        (vtp("ascii", packed=False, kind="ImageData"), "holds ImageData; expected PolyData"),
        (
            vtp("binary", packed=True).replace(b"vtkZLib", b"vtkLZMA"),
            "packed by vtkLZMADataCompressor",
        ),
        (b'<VTKFile type="PolyData"/>', "no points in it"),
        (re.sub(rb'"binary">[^<]*<', b'"binary">AAAA<', vtp("binary", packed=False)), "cut short"),
        (
            vtp("raw", packed=False).replace(b'offset="0"', b'offset="9000"'),
            "array is cut short",
        ),
        (vtp("raw", packed=True).replace(b"x\x9c", b"xx"), "cannot be unpacked"),
        (
            re.sub(rb'"binary">[^<]*<', b'"binary">A===AAAA<', vtp("binary", packed=False)),
            "no base64",
        ),
    ],
)
def test_xml_files_that_cannot_be_used_are_refused(tmp_path, content, message):
    (tmp_path / "m.vtp").write_bytes(content)
    with pytest.raises(InputError, match=rf"m.vtp'.*({message})"):
        read_arrays(tmp_path / "m.vtp")


def test_arrays_that_unpack_to_too_much_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("esd.mesh.io.polydata._LARGEST", 100)
    (tmp_path / "m.vtp").write_bytes(vtp("raw", packed=True))
    with pytest.raises(InputError, match="unpacks to more than 1 GiB"):
        read_arrays(tmp_path / "m.vtp")
