"""Excel workbooks, MCAP logs and ROS 2 bags, by libraries of extras in a process of their own."""

import numpy as np
import pytest
import sound

from vlab.cases import load_case
from vlab.errors import BadRecording, UnknownName
from vlab.recordings import isolated, open_table

RIG = """<mujoco><worldbody><body><joint name="elbow"/><geom size="0.1"/></body></worldbody>
<actuator><position name="servo" joint="elbow" kp="5" kv="1"/></actuator></mujoco>"""
CASE = """[model]
mjcf = "rig.xml"
[[recording]]
file = "bag"
role = "fit"
[[recording.channel]]
column = "/command/target[0]"
at = "servo"
kind = "command"
unit = "deg"
input = true
time = "/command/time"
[[recording.channel]]
column = "/joint_states/position[elbow]"
at = "joint:elbow"
kind = "angle"
unit = "deg"
time = "/joint_states/time"
"""


def write(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    return tmp_path / name


def test_a_missing_library_is_named_with_its_extra(tmp_path, monkeypatch):
    monkeypatch.setattr(isolated, "is_installed", lambda library: False)
    for name, extra in (("run.xlsx", "xlsx"), ("run.mcap", "ros"), ("run.db3", "ros")):
        with pytest.raises(BadRecording, match=rf"pip install 'vlab-vibration\[{extra}\]'"):
            open_table(write(tmp_path, name, b"PK\3\4"))


# ---- Excel -----------------------------------------------------------------------------------------------------------


def test_a_workbook_gives_the_same_numbers(tmp_path):
    pytest.importorskip("openpyxl")
    table = open_table(write(tmp_path, "run.xlsx", sound.xlsx()))
    assert table.names == ("t [s]", "x")
    np.testing.assert_array_equal(table["x"], np.sin(sound.TIMES))
    assert table.units == {"t [s]": "s"}
    assert table.notes[0] == "sheet 'Run' is read, not 'Notes'"


@pytest.mark.slow
def test_titles_units_blank_cells_and_text_of_a_workbook(tmp_path):
    pytest.importorskip("openpyxl")
    rows = [["Test of a beam"], ["t", "F"], ["s", "N"], [0.0, 1.5], [0.1, None], [0.2, 2.5]]
    path = write(tmp_path, "run.xlsx", sound.xlsx(rows))
    table = open_table(path, columns=["F"], blanks=["F"])
    np.testing.assert_array_equal(table["F"], [1.5, np.nan, 2.5])
    assert table.units == {"F": "N"}
    with pytest.raises(BadRecording, match="empty"):
        open_table(path, columns=["F"])
    with pytest.raises(BadRecording, match="no sheet holds numbers"):
        open_table(write(tmp_path, "text.xlsx", sound.xlsx([["a", "b"]])))
    with pytest.raises(BadRecording, match="not a whole workbook"):
        open_table(write(tmp_path, "cut.xlsx", sound.xlsx()[:500]))


# ---- ROS -------------------------------------------------------------------------------------------------------------


def test_topics_of_an_mcap_log_have_clocks_of_their_own(tmp_path):
    pytest.importorskip("mcap_ros2")
    table = open_table(write(tmp_path, "run.mcap", sound.mcap()))
    np.testing.assert_allclose(table["/joint_states/time"], np.arange(7) / 100, atol=1e-12)
    np.testing.assert_allclose(table["/joint_states/header.stamp"], np.arange(7) / 100, atol=1e-12)
    np.testing.assert_allclose(table["/command/time"], np.arange(0, 7, 2) / 100 + 0.002, atol=1e-12)
    np.testing.assert_array_equal(table["/command/target[0]"], 0.5 * np.arange(0, 7, 2))
    np.testing.assert_array_equal(table["/joint_states/position[1]"], -0.2 * np.arange(7))
    assert table.notes == (f"times count from {sound.START * 10**9} ns since 1970, the first message",)


def test_elements_of_a_joint_state_are_known_by_the_joint(tmp_path):
    pytest.importorskip("mcap_ros2")
    path = write(tmp_path, "run.mcap", sound.mcap())
    table = open_table(path, columns=["/joint_states/position[wrist]"])
    np.testing.assert_array_equal(table["/joint_states/position[wrist]"], -0.2 * np.arange(7))
    with pytest.raises(UnknownName, match=r"did you mean '/joint_states/position\[elbow\]' or"):
        open_table(path, columns=["elbow"])


@pytest.mark.parametrize("definition", ["", sound.JOINT_STATE])
def test_a_bag_with_and_without_definitions(tmp_path, definition):
    pytest.importorskip("mcap_ros2")
    table = open_table(write(tmp_path, "run.db3", sound.db3(definition=definition)))
    np.testing.assert_allclose(table["/joint_states/time"], np.arange(7) / 100, atol=1e-12)
    np.testing.assert_array_equal(table["/joint_states/velocity[elbow]"], np.full(7, 10.0))
    with pytest.raises(BadRecording, match="my_msgs/msg/Odd, whose definition is not in the bag"):
        table["/odd"]


def test_damaged_logs_are_refused_in_one_line(tmp_path):
    pytest.importorskip("mcap_ros2")
    for name, content, match in (
        ("run.mcap", sound.mcap()[:300], "not a whole MCAP file|damaged"),
        ("run.mcap", b"\x89MCAP0\r\n" + b"\0" * 100, "damaged"),
        ("run.db3", sound.db3()[:5000], "not a whole ROS 2 bag|damaged"),
    ):
        with pytest.raises(BadRecording, match=match) as caught:
            open_table(write(tmp_path, name, content))
        assert "\n" not in str(caught.value)


def test_a_bag_without_its_tables_is_refused(tmp_path):
    pytest.importorskip("mcap_ros2")
    import sqlite3

    other = sqlite3.connect(":memory:")
    other.execute("CREATE TABLE notes(text TEXT)")
    other.commit()
    with pytest.raises(BadRecording, match="tables 'topics' and 'messages' are missing"):
        open_table(write(tmp_path, "run.db3", other.serialize()))


def test_topics_of_a_robot_log_are_put_on_the_clock_of_the_readings(tmp_path):
    pytest.importorskip("mcap_ros2")
    folder = tmp_path
    (folder / "rig.xml").write_text(RIG)
    (folder / "bag").mkdir()
    (folder / "bag" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    (folder / "bag" / "bag_0.mcap").write_bytes(sound.mcap(50))
    (folder / "case.toml").write_text(CASE)
    (run,) = load_case(folder).runs()
    assert run.measured.time[0] == pytest.approx(0.01)  # the first command comes 2 ms after the first reading
    assert run.measured.rate == pytest.approx(100.0)
    np.testing.assert_allclose(run.measured["joint:elbow"], np.deg2rad(0.1 * np.arange(1, 50)), atol=1e-12)
    # commands 0.5 k change 2 ms after every other reading: the mean of a step is 20 % old and 80 % new
    means = np.deg2rad([0.0, 0.2 * 0.0 + 0.8 * 1.0])
    np.testing.assert_allclose(run.measured["servo"][:2], means, atol=1e-12)
