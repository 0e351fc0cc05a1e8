"""A hostile MJCF: nothing outside its folder is read, and no product of counts is built."""

import os
import struct
import sys
import zlib

import pytest

from vlab.errors import BadStructure
from vlab.plants.mjcf import build_mjcf
from vlab.plants.mjcf_guard import check_file, check_text

MODEL = """<mujoco>{head}<worldbody>{world}<body name="mass"><joint name="z" type="slide" axis="0 0 1" stiffness="80"/>
<geom name="g" size="0.05" mass="2"/>{body}</body></worldbody>{rest}</mujoco>"""
MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def model(head="", world="", body="", rest=""):
    return MODEL.format(head=head, world=world, body=body, rest=rest)


def nested(count, depth, inner="<site/>"):
    return f'<replicate count="{count}">' * depth + inner + "</replicate>" * depth


# ---- files ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    """A folder of a model, with something outside that is none of its business."""
    here = tmp_path / "case"
    (here / "parts").mkdir(parents=True)
    (tmp_path / "secret").mkdir()
    for name in ("mesh.obj", "picture.png", "model.xml"):
        (tmp_path / "secret" / name).write_text(MESH)
    return here


def wrapped(text):
    return f"<mujocoinclude>{text}</mujocoinclude>"


USE = '<asset><mesh name="m" file="{file}"/></asset>'
OUTSIDE = {
    "directory that an included file names": (
        model('<include file="parts/a.xml"/>' + USE.format(file="mesh.obj")),
        {"parts/a.xml": wrapped('<compiler meshdir="elsewhere"/>')},
    ),
    "directory of all assets in a file included by an included one": (
        model('<include file="parts/a.xml"/>' + USE.format(file="mesh.obj")),
        {"parts/a.xml": wrapped('<include file="b.xml"/>'), "parts/b.xml": wrapped('<compiler assetdir="elsewhere"/>')},
    ),
    "folders that strippath takes off a name": (
        model('<compiler strippath="true"/>' + USE.format(file="parts/link.obj")),
        {"parts/link.obj": None},
    ),
    "a link among the parts of an included file": (
        model('<include file="parts/a.xml"/>'),
        {"parts/a.xml": wrapped(USE.format(file="link.obj"))},
    ),
    "a texture": (
        model('<compiler texturedir="elsewhere"/><asset><texture name="t" type="2d" file="picture.png"/></asset>'),
        {},
    ),
    "a side of a sky": (model('<asset><texture name="t" type="skybox" fileup="elsewhere/picture.png"/></asset>'), {}),
    "a height field": (model('<asset><hfield name="h" file="elsewhere/picture.png" size="1 1 1 1"/></asset>'), {}),
    "a skin": (model('<asset><skin name="s" file="elsewhere/mesh.obj"/></asset>'), {}),
    "a deformable mesh": (model(world='<flexcomp name="f" type="mesh" dim="2" file="elsewhere/mesh.obj"/>'), {}),
    "an attached model": (model('<asset><model name="o" file="elsewhere/model.xml"/></asset>'), {}),
    "an included file": (model('<include file="elsewhere/model.xml"/>'), {}),
}


@pytest.mark.parametrize(("text", "files"), OUTSIDE.values(), ids=OUTSIDE)
def test_no_link_leads_out_of_the_folder_whoever_names_it(folder, text, files):
    (folder / "elsewhere").symlink_to(folder.parent / "secret")
    (folder / "link.obj").symlink_to(folder.parent / "secret" / "mesh.obj")
    (folder / "rig.xml").write_text(text)
    for name, content in files.items():
        (folder / name).write_text(MESH if content is None else content)
    with pytest.raises(BadStructure, match="a link that leaves the model's folder") as caught:
        build_mjcf("rig.xml", folder=folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("attribute", ['meshdir="/etc"', 'assetdir="../secret"', 'texturedir="C:\\\\x"'])
def test_a_directory_of_an_included_file_may_not_leave_by_its_name(folder, attribute):
    (folder / "a.xml").write_text(wrapped(f"<compiler {attribute}/>"))
    (folder / "rig.xml").write_text(model('<include file="a.xml"/>'))
    with pytest.raises(BadStructure, match="absolute or leaves"):
        build_mjcf("rig.xml", folder=folder)


def test_files_of_the_folder_are_found_through_directories_and_links_inside_it(folder):
    (folder / "parts" / "mesh.obj").write_text(MESH)
    (folder / "shared.obj").symlink_to(folder / "parts" / "mesh.obj")
    (folder / "a.xml").write_text(wrapped('<compiler meshdir="parts"/>'))
    geoms = '<geom type="mesh" mesh="m"/>'
    (folder / "rig.xml").write_text(model('<include file="a.xml"/>' + USE.format(file="mesh.obj"), body=geoms))
    assert build_mjcf("rig.xml", folder=folder).model.nmesh == 1
    (folder / "rig.xml").write_text(model(USE.format(file="shared.obj"), body=geoms))
    assert build_mjcf("rig.xml", folder=folder).model.nmesh == 1


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes there")
def test_a_pipe_is_not_waited_for(folder):
    os.mkfifo(folder / "mesh.obj")
    (folder / "rig.xml").write_text(model(USE.format(file="mesh.obj")))
    with pytest.raises(BadStructure, match="a device or a pipe"):
        build_mjcf("rig.xml", folder=folder)


def test_an_attached_model_must_be_mjcf_and_not_itself(folder):
    attach = '<asset><model name="o" file="{file}"/></asset>'
    (folder / "robot.urdf").write_text('<robot name="r"><link name="a"/></robot>')
    (folder / "rig.xml").write_text(model(attach.format(file="robot.urdf")))
    with pytest.raises(BadStructure, match="root element is <robot>"):
        check_file(folder / "rig.xml", "rig.xml")
    (folder / "other.xml").write_text(model(attach.format(file="rig.xml")))
    (folder / "rig.xml").write_text(model(attach.format(file="other.xml")))
    with pytest.raises(BadStructure, match=r"other\.xml, rig\.xml: the model attaches itself"):
        check_file(folder / "rig.xml", "rig.xml")


def test_names_and_directories_are_not_multiplied_without_end(folder):
    (folder / "rig.xml").write_text(
        model(
            "".join(f'<compiler meshdir="d{i}"/>' for i in range(400))
            + "<asset>" + "".join(f'<mesh name="m{i}" file="m{i}.obj"/>' for i in range(400)) + "</asset>"
        )
    )  # fmt: skip
    with pytest.raises(BadStructure, match="names 400 files that may lie in 401 folders"):
        check_file(folder / "rig.xml", "rig.xml")


def test_a_namespace_does_not_hide_elements():
    with pytest.raises(BadStructure, match="has a namespace"):
        check_text(model(world='<replicate xmlns="x" count="10"><site/></replicate>'), "rig")


# ---- counts --------------------------------------------------------------------------------------------------------


TOO_MUCH = {
    "copies of copies": ({"world": nested(1000, 2)}, "make more than 10000 elements.*<replicate count='1000'>"),
    "copies of copies of copies": ({"world": nested(60, 3)}, "make more than 10000"),
    "copies of a grid": (
        {"world": nested(50, 1, '<flexcomp name="f" type="grid" dim="2" count="20 20 1" spacing="1 1 1"/>')},
        "flexcomp",
    ),
    "a grid": ({"world": '<flexcomp name="f" type="grid" dim="3" count="1000 1000 1000"/>'}, "flexcomp"),
    "a composite": ({"world": '<composite prefix="c" type="cable" count="100000 1 1"/>'}, "composite"),
    "cells of a grid": (
        {"world": '<flexcomp name="f" count="3 3 3" cellcount="30 30 30" dof="trilinear"/>'},
        "cellcount",
    ),
    "sensors of copies": (
        {
            "world": nested(90, 2, '<site name="a"/>'),
            "rest": "<sensor>" + '<framepos objtype="site" objname="a"/>' * 2 + "</sensor>",
        },
        "make more than 10000",
    ),
    "fields of every body": ({"head": '<size nuser_body="1000000000"/>'}, "nuser"),
    "fields of every copy": (
        {"head": '<size nuser_site="50000"/>', "world": nested(5000, 1)},
        "numbers, most of them for fields of every element",
    ),
    "fields as many as any has": ({"world": nested(5000, 1) + f'<site user="{"1 " * 30000}"/>'}, "fields of every"),
    "data of the user": ({"head": '<size nuserdata="2000000000"/>'}, "nuserdata"),
    "keyframes": ({"head": '<size nkey="100000000"/>'}, "nkey"),
    "height field": (
        {"head": '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>'},
        "hfield",
    ),
    "texture": (
        {"head": '<asset><texture name="t" type="2d" builtin="flat" width="90000" height="90000"/></asset>'},
        "texture",
    ),
    "texture of a default": (
        {
            "head": '<default><texture width="90000" height="90000"/></default>'
            '<asset><texture name="t" type="2d" builtin="flat"/></asset>'
        },
        "texture",
    ),
    "samples of the past": (
        {"rest": '<actuator><motor name="a" joint="z" nsample="16000000"/></actuator>'},
        "nsample",
    ),
    "states of an actuator": ({"rest": '<actuator><general joint="z" actdim="1e9"/></actuator>'}, "actdim"),
    "values of a sensor": ({"rest": '<sensor><user name="u" dim="1000000000"/></sensor>'}, "dim="),
    "contacts of a sensor": ({"rest": '<sensor><contact geom1="g" num="100000000"/></sensor>'}, "num="),
    "pixels of a rangefinder": (
        {
            "world": '<camera name="c" resolution="20000 20000"/>',
            "rest": '<sensor><rangefinder name="r" camera="c"/></sensor>',
        },
        "rangefinder",
    ),
    "a mesh that MuJoCo makes": (
        {"head": '<asset><mesh name="s" builtin="supersphere" params="1e5 1 1"/></asset>'},
        "supersphere",
    ),
    "a grid of a plugin": (
        {"rest": '<sensor><plugin plugin="p"><config key="size" value="90000 90000"/></plugin></sensor>'},
        "config",
    ),
    "a count of many digits": ({"world": f'<replicate count="{"9" * 5000}"><site/></replicate>'}, "make more than"),
}


@pytest.mark.parametrize(("parts", "match"), TOO_MUCH.values(), ids=TOO_MUCH)
def test_a_product_of_counts_is_refused_before_anything_is_built(parts, match, monkeypatch):
    monkeypatch.setattr("mujoco.MjSpec.from_string", None)  # would be called
    with pytest.raises(BadStructure, match=match) as caught:
        build_mjcf(model(**parts))
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith("MJCF text: ")
    assert "accepted: up to" in text
    assert "make the counts smaller" in text
    assert len(text) < 600


def test_files_that_are_included_and_attached_count_where_they_stand(folder):
    (folder / "part.xml").write_text(wrapped(nested(200, 1)))
    (folder / "rig.xml").write_text(model(world=nested(100, 1, '<include file="part.xml"/>')))
    with pytest.raises(BadStructure, match="make more than 10000"):
        check_file(folder / "rig.xml", "rig.xml")
    for k in range(14):  # each attaches the next twice: 2^14 in all
        inner = f'<asset><model name="o" file="m{k + 1}.xml"/></asset>'
        twice = '<attach model="o" prefix="a"/><attach model="o" prefix="b"/>' if k < 13 else "<site/>"
        (folder / f"m{k}.xml").write_text(model(inner if k < 13 else "", world=twice))
    with pytest.raises(BadStructure, match="make more than 10000"):
        check_file(folder / "m0.xml", "m0.xml")
    check_file(folder / "m8.xml", "m8.xml")


def test_counts_as_people_use_them_are_accepted():
    parts = {
        "head": '<size nuser_body="5" nkey="20" memory="500M"/><asset><hfield name="h" nrow="500" ncol="500" size="1 1 1 1"/>'
        '<texture name="t" type="skybox" builtin="gradient" width="800" height="4800"/>'
        '<mesh name="w" builtin="wedge" params="20 20 180 90 0"/></asset>',
        "world": '<replicate count="50" offset="1 0 0">' + nested(50, 1) + "</replicate>"
        '<flexcomp name="f" type="grid" dim="2" count="40 40 1" spacing="1 1 1"/>',
        "rest": '<actuator><motor name="a" joint="z" nsample="200"/></actuator>',
    }
    check_text(model(**parts), "rig")
    check_text(model(world='<replicate count="9999"><site/></replicate>'), "rig")


def test_a_picture_that_unpacks_to_more_than_memory_is_refused(folder):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0))
    (folder / "t.png").write_bytes(b"\x89PNG\r\n\x1a\n" + head)
    (folder / "rig.xml").write_text(model('<asset><texture name="t" type="2d" file="t.png"/></asset>'))
    with pytest.raises(BadStructure, match="unpacks to 1800000000 numbers"):
        check_file(folder / "rig.xml", "rig.xml")
