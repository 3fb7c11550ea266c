"""Broken session files: each is refused with one line that names the file, the line, the key, what and why."""

from pathlib import Path

import pytest

from manyhands.launch.session import SessionError, load_session

BROKEN = Path(__file__).parent / "broken"

# file: (line, key, words of what was found, words of what is expected)
TABLE = {
    # the text
    "empty": (1, "", "an empty file", "session: NAME"),
    "only-comments": (1, "", "an empty file", "session: NAME"),
    "list-at-top": (2, "", "a list of 2 at the top", "session: NAME"),
    "text-at-top": (1, "", "'just words' at the top", "session: NAME"),
    "binary": (2, "", "0xff", "UTF-8"),
    "control-character": (2, "", r"'\x01'", "YAML"),
    "not-yaml": (2, "", "mapping values are not allowed here", "YAML"),
    "unclosed": (3, "", "expected ',' or ']'", "YAML"),
    "tab-indentation": (4, "", r"'\t'", "indented by spaces"),
    "two-documents": (17, "", "another document", "YAML"),
    "tag": (1, "", "the tag tag:yaml.org,2002:python/object/apply:os.getcwd", "without tags"),
    "duplicate-key": (5, "devices.dx", "twice in lines 4 and 5", "each key once"),
    "numeric-key": (8, "couplings", "the key 2", "in quotes"),
    "unknown-alias": (2, "", "undefined alias 'T'", "YAML"),
    "alias-bomb": (2, "a5.0.6.8.8.8.0", "more than 200000 values", "fewer aliases"),
    "alias-of-itself": (2, "devices.dx", "alias of itself", "something else"),
    "too-deep": (2, "", "nesting deeper than 32", "flatter"),
    # keys
    "unknown-key": (4, "devices.dx.mas", "unknown key 'mas'", "damping, hand (did you mean 'mass'?)"),
    "unknown-top-key": (2, "perod", "unknown key 'perod'", "did you mean 'period'?"),
    "missing-key": (4, "devices.dx", "no key 'mass'", "the moving mass in kg"),
    "missing-design": (1, "", "no key 'design'", "design, "),
    "empty-value": (2, "period", "nothing", "a period in s"),
    "devices-not-a-mapping": (3, "devices", "a list of 2", "a mapping"),
    "links-not-a-list": (12, "environment.links", "a mapping of 1", "a list"),
    "several-problems": (2, "period", "0", "from 1e-05 to 0.1 (and 2 more)"),
    # numbers
    "zero-period": (2, "period", "0", "a period in s from 1e-05 to 0.1"),
    "long-period": (2, "period", "1", "a period in s from 1e-05 to 0.1"),
    "not-a-number": (2, "period", ".nan", "finite"),
    "infinite-stiffness": (14, "environment.links.1.stiffness", ".inf", "finite"),
    "negative-stiffness": (14, "environment.links.1.stiffness", "-3500", "N/m of at least 0"),
    "negative-mass": (4, "devices.dx.mass", "-0.2", "a mass in kg greater than 0"),
    "zero-mass": (11, "environment.masses.hub", "0", "a mass in kg greater than 0"),
    "boolean-mass": (4, "devices.dx.mass", "true", "a mass in kg"),
    "unit-in-number": (4, "devices.dx.mass", "'0.2 kg'", "a number in kg, without the unit"),
    "quoted-number": (2, "period", "'0.001'", "without quotes"),
    # names
    "bad-session-name": (1, "session", "'My Session'", "a lowercase letter"),
    "bad-device-name": (5, "devices.Dy", "'Dy'", "a lowercase letter"),
    "reserved-name": (8, "couplings.supervisor", "reserved", "other than environment, supervisor, ground"),
    "coupling-named-as-device": (8, "couplings.dx", "'dx' of a device", "no device has"),
    "mass-named-as-port": (11, "environment.masses.dx", "'dx' of a port", "no port has"),
    # devices
    "fractional-dof": (4, "devices.dx.dof", "1.5", "a whole number"),
    "too-many-dof": (4, "devices.dx.dof", "33", "from 1 to 32"),
    "wrong-driver": (4, "devices.dx.driver", "'simulatd'", "simulated"),
    "osp-not-positive": (4, "devices.dx.osp", "0", "an OSP level in N·s/m greater than 0"),
    "osp-unsymmetric": (4, "devices.dx.osp.1.0", "0.1 in row 2, column 1", "symmetric"),
    "osp-indefinite": (4, "devices.dx.osp", "the eigenvalue -1", "positive definite"),
    "osp-above-damping": (4, "devices.dx.damping", "would not be Delta_D-OSP at the declared level", "diag(damping)"),
    "mass-per-axis": (4, "devices.dx.mass", "a list of 3", "a list of 2"),
    "axes-count": (4, "devices.dx.axes", "3 axis names", "2, one for each"),
    "axis-twice": (4, "devices.dx.axes", "'x' twice", "once"),
    # hands
    "hand-not-passive": (11, "devices.d.hand.operator", "operator not passive at 20.9 rad/s", "a passive operator"),
    "hand-unstable": (4, "devices.dx.hand.operator", "a pole at 1", "a passive operator"),
    "hand-improper": (4, "devices.dx.hand.operator", "improper", "proper"),
    "hand-zero-denominator": (4, "devices.dx.hand.operator", "denominator is zero", "not 0"),
    "hand-operator-shape": (4, "devices.dx.hand.operator", "a list of 2", "1 x 1"),
    "hand-operator-key": (4, "devices.dx.hand.operator.dem", "unknown key 'dem'", "did you mean 'den'?"),
    "hand-negative-damping": (4, "devices.dx.hand.damping", "-0.1", "of at least 0"),
    "hand-unknown-key": (4, "devices.dx.hand.forse", "'forse'", "did you mean 'force'?"),
    "formula-unknown-name": (4, "devices.dx.hand.force", "unknown name 'x' at position 3", "a formula of"),
    "formula-syntax": (4, "devices.dx.hand.force", "not a formula", "a formula of"),
    "formula-attribute": (4, "devices.dx.hand.force", "attribute is not allowed", "a formula of"),
    "formula-division-by-zero": (4, "devices.dx.hand.motion", "division by zero at t = 3.0 s", "finite"),
    "trace-missing": (4, "devices.dx.hand.force", "'nowhere.csv', no such file", "a CSV file"),
    "trace-backwards": (4, "devices.dx.hand.force", "sample 3 is at 0.1 s, after 0.2 s", "increasing"),
    "trace-not-numbers": (4, "devices.dx.hand.force", "line 3: '0.1,one'", "two numbers"),
    "trace-key": (4, "devices.dx.hand.force", "a mapping with file", "{trace: FILE.csv}"),
    # couplings
    "unknown-device": (8, "couplings.cy.devices.0", "unknown device 'dyy'", "one of dx, dy (did you mean 'dy'?)"),
    "unknown-port": (8, "couplings.cy.ports.0", "unknown port 'dy.0'", "one of dx, dy"),
    "port-in-two-blocks": (8, "couplings.cy.ports.1", "'dx', which is also in the coupling 'cx'", "in one coupling"),
    "port-in-no-block": (6, "couplings", "no coupling for the port 'dy'", "exactly one"),
    "devices-and-ports": (8, "couplings.cy", "both", "one of the two"),
    # environment
    "environment-type": (10, "environment.type", "'mesh'", "network"),
    "dangling-port": (14, "environment.links.1.between.0", "unknown end 'dw'", "one of dx, dy, hub, ground"),
    "unattached-port": (12, "environment.links", "no link to the port 'dy'", "every port"),
    "mass-without-link": (11, "environment.masses.spare", "without a link", "every mass"),
    "link-to-itself": (15, "environment.links.2.between", "from 'hub' to itself", "two different ends"),
    "link-of-three": (15, "environment.links.2.between", "a list of 3", "two ends"),
    "link-of-nothing": (15, "environment.links.2", "neither stiffness nor damping", "greater than 0"),
    # design
    "linear-coupling": (16, "design.coupling", "'linear', which this version", "one of spring-damper, given, none"),
    "loop-shaping-objective": (16, "design.objective", "'loop-shaping', which this version does not have", "feasible"),
    "given-unasked": (16, "design.stiffness", "with 'coupling: spring-damper'", "'coupling: given'"),
    "given-without-values": (16, "design", "without anything given", "stiffness"),
    "given-twice": (16, "design.matrices", "besides stiffness", "either"),
    "given-outside-block": (16, "design.stiffness.0.1", "5 between 'dx' of coupling 'cx' and 'dy'", "0 between"),
    "given-unsymmetric": (15, "design.stiffness.1.0", "4.0 in row 2, column 1", "symmetric"),
    "given-not-positive": (16, "design.stiffness", "the eigenvalue -700", "positive definite"),
    "given-wrong-size": (16, "design.stiffness", "3 numbers", "for the ports dx, dy"),
    "matrices-missing-block": (16, "design.matrices", "no matrices for 'cy'", "cx, cy"),
    "matrices-unknown-block": (16, "design.matrices.cz", "unknown coupling 'cz'", "one of cx, cy"),
    "matrices-shape": (20, "design.matrices.cy.B", "a matrix of 1 x 2", "1 x 1, with 1 states and 1 ports"),
}  # fmt: skip


def test_the_table_and_the_folder_agree() -> None:
    assert {path.stem for path in BROKEN.glob("*.yaml")} == set(TABLE)


@pytest.mark.parametrize("name", TABLE)
def test_broken_file(name: str) -> None:
    line, key, found, expected = TABLE[name]
    path = BROKEN / f"{name}.yaml"
    with pytest.raises(SessionError) as caught:
        load_session(path)
    error = caught.value
    assert (error.line, error.key) == (line, key)
    assert found in str(error).partition("; expected ")[0]
    message = str(error)
    assert message.startswith(f"{path}:{line}: {key + ': ' if key else ''}found ")
    assert expected in message.partition("; expected ")[2]
    assert message.isprintable()  # so it is one line, too
