"""The configuration: defaults, a file over them, single values over that, and what is refused."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs import settings as settings_module
from pcmrs.config import as_config, as_table, merge_tables, read_file, set_values
from pcmrs.errors import ConfigurationError
from pcmrs.settings import Settings, read_settings
from pcmrs.workflows import read_workflow


class Inner(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    number: float = 1.5
    text: str = "plain"
    triple: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Outer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    inner: Inner = Inner()
    flag: bool = False


def read_config(kind: type[Outer], file: Path | None = None, overrides: Sequence[str] = ()) -> Outer:
    values = read_file(file) if file is not None else {}
    set_values(values, overrides)
    return as_config(kind, values)


Tables = st.recursive(st.integers(), lambda inner: st.dictionaries(st.sampled_from("abc"), inner, max_size=3))


@given(*[st.dictionaries(st.sampled_from("abc"), Tables, max_size=3)] * 3)
def test_layers_may_be_laid_one_by_one_or_first_the_upper_ones(low: Any, middle: Any, high: Any) -> None:
    assert merge_tables({}, low) == merge_tables(low, {}) == merge_tables(low, low) == low
    both = merge_tables(low, high)
    assert both.keys() == low.keys() | high.keys()
    for key, value in both.items():
        tables = isinstance(low.get(key), dict) and isinstance(high.get(key), dict)
        assert value == (merge_tables(low[key], high[key]) if tables else high.get(key, low.get(key)))
    if not _clashes(low, middle) and not _clashes(middle, high) and not _clashes(low, high):
        assert merge_tables(merge_tables(low, middle), high) == merge_tables(low, merge_tables(middle, high))


def _clashes(a: Any, b: Any) -> bool:
    """Whether one has a table where the other has a value."""
    if isinstance(a, dict) != isinstance(b, dict):
        return True
    return isinstance(a, dict) and any(_clashes(a[key], b[key]) for key in a.keys() & b.keys())


def test_without_anything_the_defaults_hold() -> None:
    assert read_config(Outer) == Outer()
    assert read_settings() == as_config(Settings, read_workflow("ratms").defaults)


def test_single_values_override_the_file_and_it_the_defaults(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text('flag = true\n[inner]\nnumber = 2.5\ntext = "from the file"\n')
    read = read_config(Outer, file, ["inner.number=3.5", "inner.triple=[1, 2, 3.5]"])
    assert read == Outer(Inner(3.5, "from the file", (1.0, 2.0, 3.5)), flag=True)


@pytest.mark.parametrize(
    ("text", "value"),
    [("word", "word"), ("two words", "two words"), ('"5"', "5"), ("a=b", "a=b"), ("tcp/h:1", "tcp/h:1")],
)
def test_a_value_that_is_no_toml_is_text(text: str, value: str) -> None:
    assert read_config(Outer, None, [f"inner.text={text}"]).inner.text == value


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_come_through_unchanged(number: float) -> None:
    assert read_config(Outer, None, [f"inner.number={number!r}"]).inner.number == number


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("inner.nmber=1", ("nmber", "inner")),
        ("iner.number=1", ("iner",)),
        ("inner.number=fast", ("float", "str", "inner.number")),
        ("inner.text=5", ("str", "int", "inner.text")),
        ("flag=1", ("bool", "flag")),
        ("inner=5", ("object", "inner")),
        ("inner.number.deep=5", ("inner.number",)),
        ("inner.triple=[1, 2]", ("length 3", "inner.triple")),
        ("inner.number=nan", ("inner.number", "nan", "finite")),
        ("inner.number=-inf", ("inner.number", "-inf", "finite")),
        ("inner.triple=[0, inf, 0]", ("inner.triple.1", "inf", "finite")),
        ("inner.number", ("key=value",)),
        ("=5", ("key=value",)),
        ("inner..number=5", ("key=value",)),
    ],
)
def test_a_wrong_value_is_refused_with_its_key(override: str, words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigurationError) as refused:
        read_config(Outer, None, ["inner.number=1", override] if override == "inner.number.deep=5" else [override])
    for word in words:
        assert word in refused.value.text


@pytest.mark.parametrize(
    "content",
    [
        b"inner = [",
        b"\xff\xfe",
        b"flag = yes",
        pytest.param(b"flag = " + b"1" * 5000, id="digits"),
        pytest.param(b"flag = " + b"[" * 5000, id="depth"),
    ],
)
def test_a_file_that_is_no_toml_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "cell.toml"
    file.write_bytes(content)
    with pytest.raises(ConfigurationError, match=r"cell\.toml is not TOML"):
        read_config(Outer, file)


def test_a_file_that_is_not_there_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"nowhere\.toml cannot be read"):
        read_config(Outer, tmp_path / "nowhere.toml")


def test_the_configuration_as_a_table_reads_back(tmp_path: Path) -> None:
    settings = read_settings(None, ["cell.rate=5", "sim.seed=7", "procedure.placement.standoff=0.08"])
    assert msgspec.convert(as_table(settings), Settings) == settings
    assert msgspec.json.decode(msgspec.json.encode(settings), type=Settings) == settings


def test_pose_ages_are_in_machine_time_at_any_rate_of_the_cell() -> None:
    given = read_settings(None, ["cell.rate=8", "procedure.max_pose_age=0.5"])
    assert (given.procedure.max_pose_age, given.procedure.tracking.unseen) == (0.5, 0.5)
    for_cell = given.procedure.in_cell_time(given.cell.rate)
    assert (for_cell.max_pose_age, for_cell.tracking.unseen) == (4.0, 4.0)
    assert given.procedure.in_cell_time(50.0).tracking.unseen == 5.0, "no motion goes on blindly for longer"
    assert given.procedure.in_cell_time(1.0) == given.procedure
    planning = pickle.loads(pickle.dumps(given.procedure.in_cell_time(50.0)))
    assert planning.max_pose_age == 25.0, "the process that plans gets the same limit"


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("robot.model=iiwa9", ("iiwa9", "iiwa14")),
        ("robot.driver=fanuc", ("fanuc", "kst", "sim")),
        ("tracker.driver=dwell", ("dwell", "pointer", "tracker")),
        ("cell.rate=0.5", ("cell.rate", "1.0")),
        ("cell.rate=51", ("cell.rate", "50")),
        ("cell.name=Cell One", ("Cell One", "lower-case")),
        ("cell.site=a/b", ("a/b",)),
        ("sim.sed=1", ("sim", "sed")),
        ("sim.tracker.jitter_mm=-1", ("sim", "jitter_mm")),
        ("sim.geometry.world_from_tracker.quat_wxyz=[0, 0, 0, 0]", ("quaternion", "world_from_tracker")),
        ("procedure.calibration.pointer_from_tip.quat_wxyz=[2, 0, 0, 0]", ("quaternion", "pointer_from_tip")),
        ("procedure.calibration.tool_file=a.toml", ("contact point", "pcmrs calibrate tip")),
        ("procedure.registration.residual_limit_mm=0", ("residual_limit_mm",)),
        ("procedure.registration.residual_limit_mm=inf", ("residual_limit_mm", "inf")),
        ("procedure.placement.confirm_offset=0.07", ("confirm_offset", "0.07", "standoff")),
        ("procedure.teleoperation.range=0.07", ("teleoperation.range", "0.07", "approach")),
        ("procedure.motion.joint_speed_fraction=1.5", ("joint_speed_fraction", "1.0")),
        ("gateway.planner.port=70000", ("port", "65535")),
        ("gateway.unsigned_peers=['10.0.0.1']", ("10.0.0.1", "loopback")),
    ],
)
def test_settings_that_make_no_cell_are_refused(override: str, words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigurationError) as refused:
        read_settings(None, [override])
    for word in words:
        assert word in refused.value.text


def test_a_real_device_runs_in_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    def installed(group: str) -> list[EntryPoint]:
        return [EntryPoint(name, "nowhere:open", group) for name in ("sim", "kst")] if group.endswith("drivers") else []

    monkeypatch.setattr(settings_module, "entry_points_of", installed)
    assert read_settings(None, ["robot.driver=kst"]).drivers() == {
        "kst": ["robot"],
        "sim": ["tracker", "pointer", "scene", "stimulator", "emg"],
    }
    with pytest.raises(ConfigurationError, match="kst runs in real time"):
        read_settings(None, ["robot.driver=kst", "cell.rate=2"])


def test_a_device_on_another_machine_has_no_driver_here() -> None:
    absent = ["robot", "scene", "stimulator", "emg"]
    settings = read_settings(None, [f"{device}.driver=none" for device in absent])
    assert settings.drivers() == {"sim": ["tracker", "pointer"]}


def test_a_pointer_that_is_held_still_needs_no_node() -> None:
    assert "pointer" not in read_settings(None, ["pointer.driver=dwell"]).drivers()["sim"]


def test_the_folder_is_the_users_unless_it_is_given(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert read_settings(None, ["cell.name=two"]).cell.path() == tmp_path / "pcmrs" / "lab-two"
    assert read_settings(None, ["cell.folder=~/cell"]).cell.path() == tmp_path / "home" / "cell"
    monkeypatch.delenv("XDG_STATE_HOME")
    assert read_settings().cell.path() == tmp_path / "home" / ".local" / "state" / "pcmrs" / "lab-cell1"


def test_daemon_is_the_router_and_all_others_are_clients() -> None:
    settings = read_settings(None, ["cell.site=clinic", "cell.name=two"])
    router, client = settings.bus("router"), settings.bus("client")
    assert (router.mode, client.mode) == ("router", "client")
    assert router.endpoint == client.endpoint == settings.cell.endpoint
    assert (client.site, client.cell) == ("clinic", "two")
