"""YAML to plain data with line numbers, and overrides."""

import math
from pathlib import Path

import pytest

from manyhands.launch.session import yaml
from manyhands.launch.session.errors import SessionError
from manyhands.launch.session.limits import MAX_FILE_BYTES, MAX_OVERRIDES
from manyhands.launch.session.yaml import SessionTree, SourcePlace, apply_overrides, parse_tree, read_tree


def value(text: str) -> object:
    return parse_tree(f"key: {text}", "f.yaml").data["key"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1e-3", 1e-3),
        ("1E3", 1e3),
        (".5", 0.5),
        ("1.", 1.0),
        ("-0.25e+2", -25.0),
        ("017", 17),
        ("0o17", 15),
        ("0x1F", 31),
        ("+3", 3),
        ("1_000", "1_000"),
        ("1:30", "1:30"),
        ("2001-01-01", "2001-01-01"),
        ("no", "no"),
        ("on", "on"),
        ("Yes", "Yes"),
        ("true", True),
        ("FALSE", False),
        ("~", None),
        ("", None),
        (".inf", math.inf),
        ("-.INF", -math.inf),
        ("1e999", math.inf),
        ("9" * 5000, math.inf),
        ("-" + "9" * 30, -1e30),
        ("'1e-3'", "1e-3"),
        ('"true"', "true"),
        ("1e", "1e"),
    ],
)
def test_scalars_follow_the_core_schema_of_yaml_1_2(text: str, expected: object) -> None:
    found = value(text)
    assert found == expected
    assert type(found) is type(expected)


def test_nan_is_read_so_that_validation_can_name_it() -> None:
    found = value(".nan")
    assert isinstance(found, float)
    assert math.isnan(found)


def test_every_key_and_item_has_its_line() -> None:
    tree = parse_tree("a:\n  b: 1\n  c:\n    - x\n    - {d: 2}\n", "f.yaml")
    assert {path: place.line for path, place in tree.places.items()} == {
        (): 1,
        ("a",): 1,
        ("a", "b"): 2,
        ("a", "c"): 3,
        ("a", "c", 0): 4,
        ("a", "c", 1): 5,
        ("a", "c", 1, "d"): 5,
    }
    assert tree.locate(("a", "c", 1, "missing")) == (("a", "c", 1), SourcePlace("f.yaml", 5))


def test_an_alias_is_a_copy_of_its_own() -> None:
    tree = parse_tree("a: &a {x: 1}\nb: *a\n", "f.yaml")
    changed = apply_overrides(tree, ["b.x=2"])
    assert changed.data == {"a": {"x": 1}, "b": {"x": 2}}


def test_keys_within_keys_do_not_recurse() -> None:
    text = "k0: &k0 {x: 1}\n" + "".join(f"k{i}: &k{i} {{? *k{i - 1} : 1}}\n" for i in range(1, 3000))
    with pytest.raises(SessionError, match="k1: found the key a list of 1"):
        parse_tree(text, "f.yaml")


@pytest.mark.parametrize(
    "text", ['"\\U99999999"', '"\\U00110000"', "!<%C3", "%FF", "&", "*", "| x", "[" * 40, "{" * 40]
)
def test_what_the_parser_cannot_take_is_a_session_error(text: str) -> None:
    with pytest.raises(SessionError):
        parse_tree(f"key: {text}", "f.yaml")


def test_many_values_are_refused_before_they_are_all_composed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml, "MAX_NODES", 1000)  # the limit itself takes ten seconds to reach
    with pytest.raises(SessionError, match="more than 1000 values"):
        parse_tree(f"a: [{'1,' * 1001} *", "f.yaml")  # were all composed, the stray * would be what is wrong


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match=r"nowhere\.yaml: found no such file or directory; expected a session file"):
        read_tree(tmp_path / "nowhere.yaml")
    with pytest.raises(SessionError, match="found is a folder, not a regular file; expected"):
        read_tree(tmp_path)
    with pytest.raises(SessionError, match="expected a session file"):
        read_tree(tmp_path / "zero\0byte")
    large = tmp_path / "large.yaml"
    large.write_text("#" * (MAX_FILE_BYTES + 1))
    with pytest.raises(SessionError, match="found is longer than 8388608 bytes"):
        read_tree(large)


def test_a_byte_order_mark_is_no_character(tmp_path: Path) -> None:
    path = tmp_path / "marked.yaml"
    path.write_bytes(b"\xef\xbb\xbfsession: a\n")
    assert read_tree(path).data == {"session": "a"}


@pytest.fixture
def tree() -> SessionTree:
    return parse_tree("devices:\n  dx: {mass: 0.2}\nlinks:\n- {stiffness: 1}\n- {stiffness: 2}\n", "f.yaml")


def test_overrides_replace_and_leave_the_given_tree_alone(tree: SessionTree) -> None:
    before = repr(tree)
    changed = apply_overrides(tree, ["devices.dx.mass=3e-1", "links.1.stiffness=4000", "devices.dx.osp=[1, 2]"])
    assert changed.data == {
        "devices": {"dx": {"mass": 0.3, "osp": [1, 2]}},
        "links": [{"stiffness": 1}, {"stiffness": 4000}],
    }
    assert repr(tree) == before


def test_overrides_apply_in_order_and_may_enter_each_other(tree: SessionTree) -> None:
    changed = apply_overrides(tree, ["devices.dx={mass: 1, hand: {mass: 2}}", "devices.dx.hand.mass=3"])
    assert changed.data["devices"] == {"dx": {"mass": 1, "hand": {"mass": 3}}}
    assert changed.locate(("devices", "dx", "hand", "mass"))[1].source == "--set devices.dx.hand.mass=3"
    assert changed.locate(("devices", "dx", "mass"))[1].source.startswith("--set devices.dx={mass")


def test_an_override_may_begin_the_parts_that_are_named(tree: SessionTree) -> None:
    before = repr(tree)
    begun = {("devices", "dx", "hand"), ("devices", "dx", "hand", "deep")}
    text = "devices.dx.hand.deep.mass=3"
    changed = apply_overrides(tree, [text, "devices.dx.hand.mass=1"], begun)
    assert changed.data["devices"] == {"dx": {"mass": 0.2, "hand": {"deep": {"mass": 3}, "mass": 1}}}
    assert changed.locate(("devices", "dx", "hand", "deep", "mass"))[1] == SourcePlace(f"--set {text}", None)
    assert repr(tree) == before
    with pytest.raises(SessionError, match="devices: found no 'dy'; expected dx"):
        apply_overrides(tree, ["devices.dy.hand.mass=3"], begun)
    with pytest.raises(SessionError, match=r"devices\.dx: found no 'hand'; expected a position"):
        apply_overrides(tree, ["devices.dx=[1]", "devices.dx.hand.mass=3"], begun)


def test_an_override_forgets_the_places_of_what_it_replaced(tree: SessionTree) -> None:
    changed = apply_overrides(tree, ["devices.dx=1"])
    path, place = changed.locate(("devices", "dx", "mass"))
    assert path == ("devices", "dx")
    assert place == SourcePlace("--set devices.dx=1", None)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("devices.dx.mass", "--set devices.dx.mass: found no '='; expected KEY.PATH=VALUE"),
        ("=1", "--set =1: found the path ''; expected KEY.PATH=VALUE"),
        ("a..b=1", "found the path 'a..b'"),
        ("devices.dy.mass=1", "devices: found no 'dy'; expected dx"),
        ("device.dx.mass=1", "found no 'device'; expected one of devices, links (did you mean 'devices'?)"),
        ("links.2.stiffness=1", "links: found no '2'; expected a position from 0 to 1"),
        ("links.2=1", "links: found no '2'; expected a position from 0 to 1"),
        ("links.-1.stiffness=1", "links: found no '-1'; expected a position from 0 to 1"),
        ("devices.dx.hand.mass.x=1", "expected mass, or 'hand' as a whole: devices.dx.hand={mass: {x: ...}}"),
        ("devices.dx.mass.x=1", "devices.dx.mass: found 0.2; expected a mapping or a list there"),
        ("devices.dx=mass: 1", "found 'mass: 1'; expected a plain value, or one in [ ] or { }"),
        ("devices.dx=[1", "found text that is not YAML"),
        ("devices.dx={a: 1, a: 2}", "devices.dx.a: found the key 'a' twice; expected each key once"),
        ("devices.dx=!!str 1", "found the tag"),
    ],
)
def test_overrides_that_lead_nowhere(tree: SessionTree, override: str, message: str) -> None:
    with pytest.raises(SessionError) as caught:
        apply_overrides(tree, [override])
    assert message in str(caught.value)
    assert caught.value.source == f"--set {override}"
    assert caught.value.line is None


def test_overrides_are_bounded(tree: SessionTree) -> None:
    with pytest.raises(SessionError, match="101 overrides"):
        apply_overrides(tree, ["devices.dx.mass=1"] * (MAX_OVERRIDES + 1))
    with pytest.raises(SessionError, match="at most 65536"):
        apply_overrides(tree, ["devices.dx.mass=" + "1" * 70_000])


def test_a_message_is_one_line_whatever_the_file_is_called() -> None:
    error = SessionError("a\nb.yaml", 3, "key", "tab\t", "none\x1b[0m")
    assert str(error) == r"a\nb.yaml:3: key: found tab\t; expected none\x1b[0m"
