import json
from pathlib import Path

import pytest

from esd.common import InputError
from esd.studio.project import Project, Queued, check_mesh_name, suffix_of


@pytest.fixture
def project(tmp_path) -> Project:
    return Project(tmp_path / "project")


def add(project: Project, name: str) -> int:
    path = project.folder / ".esd-upload"
    path.write_text("OFF")
    return project.add(name, path).number


def test_a_folder_with_other_things_or_a_damaged_project_is_refused(tmp_path):
    (tmp_path / "photo.jpg").write_bytes(b"x")
    with pytest.raises(InputError, match="holds other files and no project"):
        Project(tmp_path)
    (tmp_path / "project.json").write_text("{")
    with pytest.raises(InputError, match="is damaged"):
        Project(tmp_path)
    (tmp_path / "project.json").write_text('{"version": 99}')
    with pytest.raises(InputError, match="by another version"):
        Project(tmp_path)


def test_names_are_those_of_meshes():
    with pytest.raises(InputError, match=r"'a.png' is not a mesh file"):
        check_mesh_name("x/a.png")
    assert check_mesh_name("..\\..\\b.PLY") == "b.PLY"
    assert check_mesh_name("a\nb\u202e.off.gz") == "ab.off.gz"
    assert suffix_of("a.b.OFF.gz") == ".off.gz"


def test_what_is_kept_is_there_again(project):
    number = add(project, "a b<c>.off")
    project.examined(number, 10, 16, [{"what": "hole"}], "colours")
    project.set_landmarks(number, ["nose"], [3])
    project.set_up(number, "-y")
    project.given(number, "labels")
    project.set_settings({"model": "x"})
    again = Project(project.folder)
    assert again.shapes() == project.shapes()
    assert again.settings() == {"model": "x"}
    assert (again.shape(number).up, again.shape(number).labels) == ("-y", 1)
    assert again.path(again.shape(number)).name == "1-a_b_c_.off"


def test_projects_of_before_are_read(project):
    add(project, "a.off")
    path = project.folder / "project.json"
    content = json.loads(path.read_text())
    for entry in content["shapes"]:
        for key in ("up", "look", "labels", "points"):
            del entry[key]
    path.write_text(json.dumps(content))
    assert Project(project.folder).shapes() == project.shapes()


def test_a_shape_is_removed_with_all_that_is_its_own(project):
    first, second = add(project, "a.off"), add(project, "b.off")
    own = [
        project.map_path(first, second),
        project.view_path(first),
        project.labels_path(first),
        project.points_path(first),
        project.truth_path(second, first),
    ]
    kept = project.view_path(second)
    for path in (*own, kept):
        path.parent.mkdir(exist_ok=True)
        path.write_text("x")
    project.remove(first)
    assert not any(path.exists() for path in own)
    assert kept.exists()
    with pytest.raises(InputError, match="There is no shape 1"):
        project.remove(first)


def test_a_project_has_a_most_of_shapes(project, monkeypatch):
    monkeypatch.setattr("esd.studio.project._MOST_SHAPES", 1)
    add(project, "a.off")
    with pytest.raises(InputError, match="at most 1 shapes"):
        add(project, "b.off")


def test_files_that_were_being_written_are_removed_and_shapes_without_a_file_left_out(project):
    number = add(project, "a.off")
    add(project, "b.off")
    left = project.folder / "meshes" / ".esd-left"
    left.write_text("half")
    project.path(project.shape(number)).unlink()
    again = Project(project.folder)
    assert not left.exists()
    assert [shape.name for shape in again.shapes()] == ["b.off"]


def test_maps_are_listed_the_worst_first_and_damaged_ones_not_at_all(project):
    for name in "abc":
        add(project, f"{name}.off")
    folder = project.folder / "maps"
    folder.mkdir()
    for names, text in (
        ("1-2", '{"expected_accuracy": 0.9}'),
        ("1-3", '{"expected_accuracy": 0.4}'),
        ("2-3", "{"),
        ("2-9", "{}"),
        ("x-y", "{}"),
    ):
        (folder / f"{names}.json").write_text(text)
        (folder / f"{names}.csv").write_text("")
    Path(folder / "3-1.json").write_text("{}")  # without its map
    assert [(m["source"], m["target"]) for m in project.maps()] == [(1, 3), (1, 2)]


def test_the_queue_is_kept_in_order_without_what_is_damaged(project):
    wanted = [Queued("match", 1, 2, landmarks=True), Queued("carry", 2, 1), Queued("repair", 1, 1)]
    paths = [project.enqueue(each) for each in wanted]
    paths[0].unlink()
    again = Project(project.folder)
    assert again.queue() == list(zip(paths[1:], wanted[1:], strict=True))
    assert again.enqueue(wanted[0]) > paths[-1]
    for damaged in ("{", "[]", '{"kind": "match"}', '{"kind": "x", "source": 1, "target": 2}'):
        paths[1].write_text(damaged)
        assert again.queue()[0] == (paths[1], None)
