"""Broken session files: each differs from a sound one in few lines, and is named by file, line, key and reason."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

NETWORK: Final = """\
session: broken
period: 0.001
devices:
  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2}
  dy: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2}
couplings:
  cx: {devices: [dx]}
  cy: {devices: [dy]}
environment:
  type: network
  masses: {hub: 3.0}
  links:
    - {between: [dx, hub], stiffness: 3800, damping: 0.1}
    - {between: [dy, hub], stiffness: 3500, damping: 0.2}
    - {between: [hub, ground], stiffness: 2600}
design: {coupling: spring-damper}
"""
_HEAD: Final = NETWORK.partition("  type: network")[0]
WAVES: Final = NETWORK.replace("dy: {dof: 1", "dy: {dof: 2").replace(
    "    - {between: [dy, hub], stiffness: 3500, damping: 0.2}\n",
    "".join(f"    - {{between: [dy.{axis}, hub], stiffness: 3500, damping: 0.2}}\n" for axis in (0, 1)),
)
STATES: Final = f"""{_HEAD}\
  type: state-space
  A: [[-1, 0], [0, -2]]
  B: [[1, 0], [0, 1]]
  C: [[1, 0], [0, 1]]
  D: [[900, 0], [0, 900]]
design: {{coupling: spring-damper}}
"""
ENTRIES: Final = f"""{_HEAD}\
  type: transfer-function
  entries:
    - [{{num: [0.5, 900], den: [1]}}, 0]
    - [0, {{num: [900], den: [0.01, 1]}}]
design: {{coupling: spring-damper}}
"""

BOMB: Final = "session: broken\na0: &a0 [0, 0, 0, 0, 0, 0, 0, 0, 0, 0]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 9)
)
THREE_AXES: Final = """\
# H as printed: 0.1 off the diagonal
session: broken
period: 0.001
devices:
  d:
    dof: 3
    osp: 1.37
    driver: simulated
    mass: 0.2
    hand:
      operator:
        - [&h {num: [0.02, 1.2, 20], den: [1, 10.3, 100]}, 0.1, 0.1]
        - [0.1, *h, 0.1]
        - [0.1, 0.1, *h]
couplings:
  c: {devices: [d]}
environment:
  type: network
  links:
    - {between: [d.0, ground], stiffness: 2600}
    - {between: [d.1, ground], stiffness: 2600}
    - {between: [d.2, ground], stiffness: 2600}
design: {coupling: spring-damper}
"""
MANY_STATES: Final = f"""{_HEAD}\
  type: state-space
  A: [{", ".join(["[]"] * 513)}]
  B: []
  C: []
  D: [[1, 0], [0, 1]]
design: {{coupling: spring-damper}}
"""
LARGE_BLOCK: Final = "".join((
    _HEAD.replace("dof: 1", "dof: 17", 1),
    "  type: network\n  links:\n",
    *(f"    - {{between: [dx.{axis}, ground], stiffness: 100}}\n" for axis in range(17)),
    "    - {between: [dy, ground], stiffness: 100}\ndesign: {coupling: linear, order: 16}\n",
))  # fmt: skip
TRACES: Final = {"backwards.csv": "t,value\n0,0\n0.2,1\n0.1,2\n", "words.csv": "t,value\n0,0\n0.1,one\n"}


@dataclass(frozen=True)
class Broken:
    """A broken session file, and what its error names.

    Attributes:
        line: of the error.
        key: of the error.
        found: words of what was found.
        expected: words of what is expected.
        change: the new text of that line, or of lines by number; None leaves a line out.
        base: the sound file that is changed.
        whole: the file, where it is no change of a sound one.
    """

    line: int
    key: str
    found: str
    expected: str
    change: str | dict[int, str | None] = ""
    base: str = NETWORK
    whole: str | bytes | None = None

    def text(self) -> bytes:
        """The file's content."""
        if self.whole is not None:
            return self.whole if isinstance(self.whole, bytes) else self.whole.encode()
        changed = {self.line: self.change} if isinstance(self.change, str) else self.change
        lines = (changed.get(number, line) for number, line in enumerate(self.base.splitlines(), start=1))
        return "".join(f"{line}\n" for line in lines if line is not None).encode()

    def write(self, name: str, folder: Path) -> Path:
        """The file NAME.yaml, beside the traces that such files name."""
        for trace, text in TRACES.items():
            (folder / trace).write_text(text)
        path = folder / f"{name}.yaml"
        path.write_bytes(self.text())
        return path


BROKEN: Final = {
    # the text
    "empty": Broken(1, "", "an empty file", "session: NAME", whole=""),
    "only-comments": Broken(1, "", "an empty file", "session: NAME", whole="# nothing\n# here\n"),
    "list-at-top": Broken(2, "", "a list of 2 at the top", "session: NAME",
        whole="# a list\n- session: broken\n- period: 0.001\n"),
    "text-at-top": Broken(1, "", "'just words' at the top", "session: NAME", whole="just words\n"),
    "binary": Broken(2, "", "0xff", "UTF-8", whole=b"session: broken\n\x7fELF\xff\xfe\x00\x01"),
    "control-character": Broken(2, "", r"'\x01'", "YAML", whole="session: broken\nperiod: \x01\n"),
    "not-yaml": Broken(2, "", "mapping values are not allowed in this context", "YAML",
        whole="session: broken\nperiod: 0.001: 3\n"),
    "unclosed": Broken(3, "", "expected ',' or ']'", "YAML", whole="session: broken\ndevices: {dx: [1, 2\n"),
    "tab-indentation": Broken(4, "", r"'\t'", "indented by spaces",
        "\tdx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2}"),
    "two-documents": Broken(17, "", "another document", "YAML", whole="---\n".join((NETWORK, NETWORK))),
    "tag": Broken(1, "", "the tag tag:yaml.org,2002:python/object/apply:os.getcwd", "without tags",
        whole="session: !!python/object/apply:os.getcwd []\n"),
    "duplicate-key": Broken(5, "devices.dx", "twice in lines 4 and 5", "each key once",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2}"),
    "numeric-key": Broken(8, "couplings", "the key 2", "in quotes", "  2: {devices: [dy]}"),
    "unknown-alias": Broken(2, "", "undefined alias 'T'", "YAML", whole="session: broken\nperiod: *T\n"),
    "alias-bomb": Broken(2, "a5.1.5.8.8.8.0", "more than 300000 values", "fewer aliases", whole=BOMB),
    "alias-of-itself": Broken(2, "devices.dx", "alias of itself", "something else",
        whole="session: broken\ndevices: &d\n  dx: *d\n"),
    "too-deep": Broken(2, "", "nesting deeper than 32", "flatter",
        whole=f"session: broken\nperiod: {'[' * 100 + ']' * 100}\n"),
    # keys
    "unknown-key": Broken(4, "devices.dx.mas", "unknown key 'mas'", "mass and 7 more (did you mean 'mass'?)",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mas: 0.2}"),
    "unknown-top-key": Broken(2, "perod", "unknown key 'perod'", "did you mean 'period'?", "perod: 0.001"),
    "missing-key": Broken(4, "devices.dx", "no key 'mass'", "the least moving mass in kg",
        "  dx: {dof: 1, osp: 1.37, driver: simulated}"),
    "missing-design": Broken(1, "", "no key 'design'", "design, ", {16: None}),
    "empty-value": Broken(2, "period", "nothing", "a period in s", "period:"),
    "devices-not-a-mapping": Broken(3, "devices", "a list of 2", "a mapping",
        {4: "  - dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2}",
        5: "  - dy: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2}"}),
    "links-not-a-list": Broken(12, "environment.links", "a mapping of 1", "a list",
        {12: "  links: {between: [dx, hub]}", 13: None, 14: None, 15: None}),
    "several-problems": Broken(2, "period", "0", "from 1e-05 to 0.1 (and 2 more)",
        {2: "period: 0", 4: "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: -1}", 11: "  masses: {hub: x}"}),
    # numbers
    "zero-period": Broken(2, "period", "0", "a period in s from 1e-05 to 0.1", "period: 0"),
    "long-period": Broken(2, "period", "1", "a period in s from 1e-05 to 0.1", "period: 1"),
    "not-a-number": Broken(2, "period", ".nan", "finite", "period: .nan"),
    "infinite-stiffness": Broken(14, "environment.links.1.stiffness", ".inf", "finite",
        "    - {between: [dy, hub], stiffness: .inf, damping: 0.2}"),
    "negative-stiffness": Broken(14, "environment.links.1.stiffness", "-3500", "N/m of at least 0",
        "    - {between: [dy, hub], stiffness: -3500, damping: 0.2}"),
    "negative-mass": Broken(4, "devices.dx.mass", "-0.2", "a mass in kg greater than 0",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: -0.2}"),
    "zero-mass": Broken(11, "environment.masses.hub", "0", "a mass in kg greater than 0", "  masses: {hub: 0}"),
    "boolean-mass": Broken(4, "devices.dx.mass", "true", "a mass in kg",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: true}"),
    "unit-in-number": Broken(4, "devices.dx.mass", "'0.2 kg'", "a number in kg, without the unit",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2 kg}"),
    "quoted-number": Broken(2, "period", "'0.001'", "without quotes", "period: '0.001'"),
    # names
    "bad-session-name": Broken(1, "session", "'My Session'", "a lowercase letter", "session: My Session"),
    "bad-device-name": Broken(5, "devices.Dy", "'Dy'", "a lowercase letter",
        "  Dy: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2}"),
    "reserved-name": Broken(8, "couplings.supervisor", "reserved", "other than environment, supervisor, ground",
        "  supervisor: {devices: [dy]}"),
    "coupling-named-as-device": Broken(8, "couplings.dx", "'dx' of a device", "no device has", "  dx: {devices: [dy]}"),
    "mass-named-as-port": Broken(11, "environment.masses.dx", "'dx' of a port", "no port has",
        "  masses: {hub: 3.0, dx: 1.0}"),
    # devices
    "fractional-dof": Broken(4, "devices.dx.dof", "1.5", "a whole number",
        "  dx: {dof: 1.5, osp: 1.37, driver: simulated, mass: 0.2}"),
    "too-many-dof": Broken(4, "devices.dx.dof", "33", "from 1 to 32",
        "  dx: {dof: 33, osp: 1.37, driver: simulated, mass: 0.2}"),
    "wrong-driver": Broken(4, "devices.dx.driver", "'simulatd'", "simulated",
        "  dx: {dof: 1, osp: 1.37, driver: simulatd, mass: 0.2}"),
    "osp-not-positive": Broken(4, "devices.dx.osp", "0", "an OSP level in N·s/m greater than 0",
        "  dx: {dof: 1, osp: 0, driver: simulated, mass: 0.2}"),
    "osp-unsymmetric": Broken(4, "devices.dx.osp.1.0", "0.1 in row 2, column 1", "symmetric",
        "  dx: {dof: 2, osp: [[1, 0.2], [0.1, 1]], driver: simulated, mass: 0.2}"),
    "osp-indefinite": Broken(4, "devices.dx.osp", "the eigenvalue -1", "positive definite",
        "  dx: {dof: 2, osp: [[1, 2], [2, 1]], driver: simulated, mass: 0.2}"),
    "osp-above-damping": Broken(4, "devices.dx.damping", "would not be Delta_D-OSP at the declared level",
        "diag(damping)",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, damping: 1.0}"),
    "mass-per-axis": Broken(4, "devices.dx.mass", "a list of 3", "a list of 2",
        "  dx: {dof: 2, osp: 1.37, driver: simulated, mass: [0.2, 0.2, 0.2]}"),
    "axes-count": Broken(4, "devices.dx.axes", "3 axis names", "2, one for each",
        "  dx: {dof: 2, axes: [x, y, z], osp: 1.37, driver: simulated, mass: 0.2}"),
    "axis-twice": Broken(4, "devices.dx.axes", "'x' twice", "once",
        "  dx: {dof: 2, axes: [x, x], osp: 1.37, driver: simulated, mass: 0.2}"),
    "osp-interval-reversed": Broken(4, "devices.dx.osp.between", "end 1.5 above the higher end 1.2", "low at most high",
        "  dx: {dof: 1, osp: {between: [1.5, 1.2]}, driver: simulated, mass: 0.2}"),
    "osp-interval-not-positive": Broken(4, "devices.dx.osp.between.0", "0", "an OSP level in N·s/m greater than 0",
        "  dx: {dof: 1, osp: {between: [0, 1.2]}, driver: simulated, mass: 0.2}"),
    "osp-interval-one-end": Broken(4, "devices.dx.osp.between", "a list of 1", "two ends",
        "  dx: {dof: 1, osp: {between: [1.2]}, driver: simulated, mass: 0.2}"),
    "osp-interval-key": Broken(4, "devices.dx.osp.betwen", "unknown key 'betwen'", "between",
        "  dx: {dof: 1, osp: {betwen: [1.2, 1.5]}, driver: simulated, mass: 0.2}"),
    "osp-interval-matrix": Broken(4, "devices.dx.osp.between.1.0", "a list of 1", "an OSP level in N·s/m",
        "  dx: {dof: 1, osp: {between: [1.2, [[1.5]]]}, driver: simulated, mass: 0.2}"),
    "osp-interval-axes": Broken(4, "devices.dx.osp.between.0", "a list of 2", "a list of 1, one for each axis",
        "  dx: {dof: 1, osp: {between: [[1.2, 1.3], 1.5]}, driver: simulated, mass: 0.2}"),
    "osp-interval-above-damping": Broken(4, "devices.dx.damping", "the damping 1.1 for an OSP level of 1.2",
        "smaller osp",
        "  dx: {dof: 1, osp: {between: [1.2, 1.5]}, driver: simulated, mass: 0.2, damping: 1.1}"),
    "limits-zero": Broken(4, "devices.dx.limits.force", "0", "a limit of the force in N greater than 0",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, limits: {force: 0}}"),
    "limits-negative": Broken(4, "devices.dx.limits.displacement", "-0.2", "in m greater than 0",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, limits: {displacement: -0.2}}"),
    "limits-infinite": Broken(4, "devices.dx.limits.speed", ".inf", "in m/s greater than 0, and finite",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, limits: {speed: .inf}}"),
    "limits-unit": Broken(4, "devices.dx.limits.speed", "'2 m/s'", "a number in m/s, without the unit",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, limits: {speed: 2 m/s}}"),
    "limits-key": Broken(4, "devices.dx.limits.forse", "unknown key 'forse'",
        "hand, power, energy (did you mean 'force'?)",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, limits: {forse: 8}}"),
    "limits-number": Broken(4, "devices.dx.limits", "8", "a mapping with the keys force, displacement, speed",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, limits: 8}"),
    "limits-per-axis": Broken(4, "devices.dx.limits.force", "a list of 2", "a list of 1, one for each axis",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, limits: {force: [8, 8]}}"),
    # hands
    "hand-not-passive": Broken(11, "devices.d.hand.operator", "operator not passive at 20.9 rad/s",
        "a passive operator",
        whole=THREE_AXES),
    "hand-unstable": Broken(4, "devices.dx.hand.operator", "a pole at 1", "a passive operator",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {operator: {num: [1], den: [1, -1]}}}"),
    "hand-improper": Broken(4, "devices.dx.hand.operator", "improper", "proper",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {operator: {num: [1, 0], den: [1]}}}"),
    "hand-zero-denominator": Broken(4, "devices.dx.hand.operator", "denominator is zero", "not 0",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {operator: {num: [1], den: [0]}}}"),
    "hand-operator-shape": Broken(4, "devices.dx.hand.operator", "a list of 2", "1 x 1",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {operator: [1, 2]}}"),
    "hand-operator-key": Broken(4, "devices.dx.hand.operator.dem", "unknown key 'dem'", "did you mean 'den'?",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {operator: {num: [1], dem: [1]}}}"),
    "hand-negative-damping": Broken(4, "devices.dx.hand.damping", "-0.1", "of at least 0",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {damping: -0.1}}"),
    "hand-unknown-key": Broken(4, "devices.dx.hand.forse", "'forse'", "did you mean 'force'?",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {forse: 1}}"),
    "formula-unknown-name": Broken(4, "devices.dx.hand.force", "unknown name 'x' at position 3", "a formula of",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {force: \"2*x\"}}"),
    "formula-syntax": Broken(4, "devices.dx.hand.force", "not a formula", "a formula of",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {force: \"2*(t\"}}"),
    "formula-attribute": Broken(4, "devices.dx.hand.force", "attribute is not allowed", "a formula of",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {force: \"t.real\"}}"),
    "formula-division-by-zero": Broken(4, "devices.dx.hand.motion", "division by zero at t = 3.0 s", "finite",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {motion: \"1/(t - 3)\"}}"),
    "trace-missing": Broken(4, "devices.dx.hand.force", "'nowhere.csv', no such file", "a CSV file",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {force: {trace: nowhere.csv}}}"),
    "trace-backwards": Broken(4, "devices.dx.hand.force", "sample 3 is at 0.1 s, after 0.2 s", "increasing",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {force: {trace: backwards.csv}}}"),
    "trace-not-numbers": Broken(4, "devices.dx.hand.force", "line 3: no two numbers", "two numbers",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {force: {trace: words.csv}}}"),
    "trace-key": Broken(4, "devices.dx.hand.force", "a mapping with file", "{trace: FILE.csv}",
        "  dx: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2, hand: {force: {file: words.csv}}}"),
    # couplings
    "unknown-device": Broken(8, "couplings.cy.devices.0", "unknown device 'dyy'", "one of dx, dy (did you mean 'dy'?)",
        "  cy: {devices: [dyy]}"),
    "unknown-port": Broken(8, "couplings.cy.ports.0", "unknown port 'dy.1'", "one of dx, dy", "  cy: {ports: [dy.1]}"),
    "port-in-two-blocks": Broken(8, "couplings.cy.ports.1", "'dx', which is also in the coupling 'cx'",
        "in one coupling",
        "  cy: {ports: [dy, dx]}"),
    "port-in-no-block": Broken(6, "couplings", "no coupling for the port 'dy'", "exactly one", {8: None}),
    "devices-and-ports": Broken(8, "couplings.cy", "both", "one of the two", "  cy: {devices: [dy], ports: [dy]}"),
    # environment
    "environment-type": Broken(10, "environment.type", "'cloud'", "network", "  type: cloud"),
    "dangling-port": Broken(14, "environment.links.1.between.0", "unknown end 'dw'", "one of dx, dy, hub, ground",
        "    - {between: [dw, hub], stiffness: 3500, damping: 0.2}"),
    "dangling-device": Broken(14, "environment.links.1.between.0", "unknown end 'dy'",
        "dy.x, dy.z: the device dy has 2",
        {5: "  dy: {dof: 2, axes: [x, z], osp: 1.37, driver: simulated, mass: 0.2}"}),
    "unattached-port": Broken(12, "environment.links", "no link to the port 'dy'", "every port", {14: None}),
    "mass-without-link": Broken(11, "environment.masses.spare", "without a link", "every mass",
        "  masses: {hub: 3.0, spare: 1.0}"),
    "link-to-itself": Broken(15, "environment.links.2.between", "from 'hub' to itself", "two different ends",
        "    - {between: [hub, hub], stiffness: 2600}"),
    "link-of-three": Broken(15, "environment.links.2.between", "a list of 3", "two ends",
        "    - {between: [hub, dx, ground], stiffness: 2600}"),
    "link-of-nothing": Broken(15, "environment.links.2", "neither stiffness nor damping", "greater than 0",
        "    - {between: [hub, ground]}"),
    "interval-bare-list": Broken(14, "environment.links.1.stiffness", "a list of 2",
        "at least 0, or {between: [low, high]}",
        "    - {between: [dy, hub], stiffness: [3400, 3600], damping: 0.2}"),
    "interval-reversed": Broken(14, "environment.links.1.stiffness.between", "3600 above the higher end 3400", "low at",
        "    - {between: [dy, hub], stiffness: {between: [3600, 3400]}, damping: 0.2}"),
    "interval-negative": Broken(14, "environment.links.1.damping.between.0", "-0.1",
        "a damping in N·s/m of at least 0",
        "    - {between: [dy, hub], stiffness: 3500, damping: {between: [-0.1, 0.2]}}"),
    "interval-of-mass-zero": Broken(11, "environment.masses.hub.between.0", "0", "a mass in kg greater than 0",
        "  masses: {hub: {between: [0, 3]}}"),
    "interval-three-ends": Broken(14, "environment.links.1.stiffness.between", "a list of 3", "two ends",
        "    - {between: [dy, hub], stiffness: {between: [3400, 3500, 3600]}, damping: 0.2}"),
    "interval-empty": Broken(14, "environment.links.1.stiffness", "no key 'between'", "{between: [low, high]}",
        "    - {between: [dy, hub], stiffness: {}, damping: 0.2}"),
    "interval-plus-minus": Broken(14, "environment.links.1.stiffness.nominal", "unknown key 'nominal'", "between",
        "    - {between: [dy, hub], stiffness: {between: [3400, 3600], nominal: 3500}, damping: 0.2}"),
    "interval-unit": Broken(14, "environment.links.1.stiffness.between.1", "'3600 N/m'",
        "a number in N/m, without the unit",
        "    - {between: [dy, hub], stiffness: {between: [3400, 3600 N/m]}, damping: 0.2}"),
    "interval-of-nothing": Broken(15, "environment.links.2", "neither stiffness nor damping", "greater than 0",
        "    - {between: [hub, ground], stiffness: {between: [0, 0]}}"),
    "interval-and-delay": Broken(16, "environment.delay", "a delay of 1 with intervals", "delay: 0",
        {14: "    - {between: [dy, hub], stiffness: {between: [3400, 3600]}, damping: 0.2}",
        15: "    - {between: [hub, ground], stiffness: 2600}\n  delay: 1"}),
    "delay-fractional": Broken(11, "environment.delay", "0.5", "a whole number of ticks from 0 to 16",
        {10: "  type: network\n  delay: 0.5"}),
    "delay-negative": Broken(11, "environment.delay", "-1", "a whole number of ticks from 0 to 16",
        {10: "  type: network\n  delay: -1"}),
    "delay-long": Broken(11, "environment.delay", "17", "a whole number of ticks from 0 to 16",
        {10: "  type: network\n  delay: 17"}),
    "network-with-matrices": Broken(11, "environment.A", "unknown key 'A'",
        "one of type, masses, inertias, links, delay", {10: "  type: network\n  A: [[1]]"}),
    "environment-without-type": Broken(9, "environment", "no key 'type'",
        "network, scene, state-space, transfer-function",
        {10: None, 12: "  links: []", 13: None, 14: None, 15: None}),
    "environment-type-misspelt": Broken(10, "environment.typ", "unknown key 'typ'", "type",
        {10: "  typ: network", 11: "  links: []", 12: None, 13: None}, base=ENTRIES),
    "environment-not-a-mapping": Broken(9, "environment", "'network'", "a mapping with the key type",
        {9: "environment: network", 10: None, 11: None, 12: None, 13: None}, base=ENTRIES),
    "state-space-missing-matrix": Broken(9, "environment", "no key 'D'", "the m x m matrix D", {14: None}, base=STATES),
    "state-space-ports": Broken(12, "environment.B", "a matrix of 2 x 1", "2 x 2, with 2 states and 2 ports",
        "  B: [[1], [1]]", base=STATES),
    "state-space-not-square": Broken(11, "environment.A", "a matrix of 2 x 1", "2 x 2, with 2 states",
        "  A: [[-1], [0]]", base=STATES),
    "state-space-ragged": Broken(13, "environment.C", "rows of different lengths", "the same length",
        "  C: [[1, 0], [1]]", base=STATES),
    "state-space-word": Broken(14, "environment.D.1.1", "'stiff'", "a number",
        "  D: [[900, 0], [0, stiff]]", base=STATES),
    "state-space-infinite": Broken(11, "environment.A.1.1", "-.inf", "finite",
        "  A: [[-1, 0], [0, -.inf]]", base=STATES),
    "state-space-order": Broken(11, "environment.A", "513 states", "at most 512", whole=MANY_STATES),
    "state-space-time": Broken(15, "environment.time", "'sampled'", "one of continuous, discrete",
        {14: "  D: [[900, 0], [0, 900]]\n  time: sampled"}, base=STATES),
    "state-space-method": Broken(15, "environment.method", "'euler'", "one of backward-euler, tustin, zoh",
        {14: "  D: [[900, 0], [0, 900]]\n  method: euler"}, base=STATES),
    "state-space-method-of-discrete": Broken(16, "environment.method", "'zoh' with 'time: discrete'", "or no method",
        {14: "  D: [[900, 0], [0, 900]]\n  time: discrete\n  method: zoh"}, base=STATES),
    "state-space-links": Broken(15, "environment.links", "unknown key 'links'",
        "A, B, C, D, static, time, method, delay",
        {14: "  D: [[900, 0], [0, 900]]\n  links: []"}, base=STATES),
    "state-space-delay": Broken(15, "environment.delay", "true", "a whole number of ticks",
        {14: "  D: [[900, 0], [0, 900]]\n  delay: true"}, base=STATES),
    "transfer-function-ports": Broken(12, "environment.entries.0", "a row of 1", "2 entries, one for each port",
        "    - [{num: [900], den: [1]}]", base=ENTRIES),
    "transfer-function-rows": Broken(11, "environment.entries", "a list of 1", "2 rows of 2 entries",
        {11: "  entries: [[900]]", 12: None, 13: None}, base=ENTRIES),
    "transfer-function-flat": Broken(11, "environment.entries.1", "900", "a list of 1 to 2048 entries",
        {11: "  entries: [[900, 0], 900]", 12: None, 13: None}, base=ENTRIES),
    "transfer-function-zero-denominator": Broken(12, "environment.entries.0.0.den", "denominator that is 0",
        "other than 0",
        "    - [{num: [900], den: [0, 0]}, 0]", base=ENTRIES),
    "transfer-function-key": Broken(12, "environment.entries.0.0.dem", "unknown key 'dem'", "did you mean 'den'?",
        "    - [{num: [900], dem: [1]}, 0]", base=ENTRIES),
    "transfer-function-no-numerator": Broken(12, "environment.entries.0.0", "no key 'num'", "a plain number in N/m",
        "    - [{den: [1]}, 0]", base=ENTRIES),
    "transfer-function-degree": Broken(12, "environment.entries.0.0.num", "a list of 18", "1 to 17 coefficients",
        "    - [{num: [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1], den: [1]}, 0]", base=ENTRIES),
    "transfer-function-text": Broken(12, "environment.entries.0.0", "'k + b s'", "a number in N/m",
        "    - [k + b s, 0]", base=ENTRIES),
    "transfer-function-tustin-improper": Broken(14, "environment.method", "row 1, column 1 (degree 1 over 0)",
        "or proper",
        {13: "    - [0, {num: [900], den: [0.01, 1]}]\n  method: tustin"}, base=ENTRIES),
    "transfer-function-zoh": Broken(14, "environment.method", "'zoh'", "one of backward-euler, tustin",
        {13: "    - [0, {num: [900], den: [0.01, 1]}]\n  method: zoh"}, base=ENTRIES),
    # design
    "coupling-unknown": Broken(16, "design.coupling", "'nonlinear'", "one of spring-damper, linear, given, none",
        "design: {coupling: nonlinear}"),
    "linear-without-order": Broken(16, "design", "'coupling: linear' without order", "the states for each port",
        "design: {coupling: linear}"),
    "order-zero": Broken(16, "design.order", "0", "a whole number of states for each port from 1 to 16",
        "design: {coupling: linear, order: 0}"),
    "order-large": Broken(16, "design.order", "17", "from 1 to 16", "design: {coupling: linear, order: 17}"),
    "order-fractional": Broken(16, "design.order.cy", "1.5", "a whole number",
        "design: {coupling: linear, order: {cx: 2, cy: 1.5}}"),
    "order-unknown-block": Broken(16, "design.order.cz", "unknown coupling 'cz'", "one of cx, cy",
        "design: {coupling: linear, order: {cx: 2, cy: 2, cz: 2}}"),
    "order-missing-block": Broken(16, "design.order", "no order for 'cy'", "an order for cx, cy",
        "design: {coupling: linear, order: {cx: 2}}"),
    "order-of-spring-damper": Broken(16, "design.order", "order with 'coupling: spring-damper'", "'coupling: linear'",
        "design: {coupling: spring-damper, order: 2}"),
    "order-of-large-block": Broken(30, "design.order", "272 states of the coupling 'cx' with 17 ports", "at most 256",
        whole=LARGE_BLOCK),
    "poles-of-spring-damper": Broken(16, "design.poles", "poles with 'coupling: spring-damper'", "'coupling: linear'",
        "design: {coupling: spring-damper, poles: [{frequency: 52}]}"),
    "poles-count": Broken(16, "design.poles", "2 poles, in pairs, for order 4", "or order: 2",
        "design: {coupling: linear, order: 4, poles: [{frequency: 52, damping: 0.05}]}"),
    "poles-undamped": Broken(16, "design.poles.0.damping", "0", "greater than 0 and at most 1",
        "design: {coupling: linear, order: 2, poles: [{frequency: 52, damping: 0}]}"),
    "poles-overdamped": Broken(16, "design.poles.0.damping", "1.5", "greater than 0 and at most 1",
        "design: {coupling: linear, order: 2, poles: [{frequency: 52, damping: 1.5}]}"),
    "poles-without-frequency": Broken(16, "design.poles.0", "no key 'frequency'", "in rad/s",
        "design: {coupling: linear, order: 2, poles: [{damping: 0.05}]}"),
    "poles-numbers": Broken(16, "design.poles.0", "52", "a mapping with the keys frequency, damping",
        "design: {coupling: linear, order: 2, poles: [52]}"),
    "poles-with-complementarity": Broken(16, "design.poles", "with 'algorithm: complementarity'", "'algorithm: convex'",
        "design: {coupling: linear, order: 2, poles: [{frequency: 52}], algorithm: complementarity}"),
    "algorithm-unknown": Broken(16, "design.algorithm", "'ccl'", "one of convex, complementarity",
        "design: {coupling: spring-damper, algorithm: ccl}"),
    "algorithm-of-given": Broken(16, "design.algorithm", "with 'coupling: given'",
        "'coupling: spring-damper' or 'linear'",
        "design: {coupling: given, stiffness: 700, algorithm: complementarity}"),
    "algorithm-with-objective": Broken(16, "design.algorithm", "with 'objective: stiffest'", "'objective: feasible'",
        "design: {coupling: spring-damper, algorithm: complementarity, objective: stiffest}"),
    "iterations-of-convex": Broken(16, "design.iterations", "with 'algorithm: convex'", "'algorithm: complementarity'",
        "design: {coupling: spring-damper, iterations: 100}"),
    "iterations-zero": Broken(16, "design.iterations", "0", "from 1 to 10000",
        "design: {coupling: spring-damper, algorithm: complementarity, iterations: 0}"),
    "objective-unknown": Broken(16, "design.objective", "'loopshaping'", "did you mean 'loop-shaping'?",
        "design: {coupling: spring-damper, objective: loopshaping}"),
    "objective-of-none": Broken(16, "design.objective", "loop-shaping with 'coupling: none'", "feasible",
        "design: {coupling: none, objective: loop-shaping}"),
    "objective-of-given": Broken(16, "design.objective", "stiffest with 'coupling: given'", "loop-shaping, closed-loop",
        "design: {coupling: given, stiffness: 700, objective: stiffest}"),
    "weights-unasked": Broken(16, "design.weights", "weights with 'objective: stiffest'", "'objective: loop-shaping'",
        "design: {coupling: spring-damper, objective: stiffest, weights: {W1: {emphasise: [0, 20]}}}"),
    "weights-key": Broken(16, "design.weights.W3", "unknown key 'W3'", "one of W1, W2",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W3: {emphasise: [0, 20]}}}"),
    "weights-number": Broken(16, "design.weights.W1", "2", "a mapping with the keys num, den, emphasise",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W1: 2}}"),
    "weight-empty": Broken(16, "design.weights.W1", "nothing in it", "{emphasise: [low, high]} in Hz",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W1: {}}}"),
    "weight-both-forms": Broken(16, "design.weights.W1.emphasise", "emphasise besides num",
        "or {emphasise: [low, high]}",
        "design: {coupling: spring-damper, objective: loop-shaping, "
        "weights: {W1: {num: [1], den: [1], emphasise: [0, 20]}}}"),
    "weight-numerator-alone": Broken(16, "design.weights.W1", "num alone", "{num: [...], den: [...]} in s",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W1: {num: [1]}}}"),
    "weight-unstable": Broken(16, "design.weights.W1.den", "a pole at about 125 rad/s", "open left half plane",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W1: {num: [1], den: [0.008, -1]}}}"),
    "weight-integrator": Broken(16, "design.weights.W1.den", "a pole at about 0 rad/s", "open left half plane",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W1: {num: [1], den: [1, 0]}}}"),
    "weight-improper": Broken(16, "design.weights.W2.num", "an improper weight, of degree 1 over 0", "no higher degree",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W2: {num: [1, 0], den: [1]}}}"),
    "weight-zero": Broken(16, "design.weights.W1.num", "all 0", "other than 0",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W1: {num: [0, 0], den: [1]}}}"),
    "weight-zero-denominator": Broken(16, "design.weights.W1.den", "all 0", "other than 0",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W1: {num: [1], den: [0]}}}"),
    "weight-band-reversed": Broken(16, "design.weights.W1.emphasise", "a band from 20 to 5 Hz", "low less than high",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W1: {emphasise: [20, 5]}}}"),
    "weight-band-number": Broken(16, "design.weights.W1.emphasise", "20", "the two edges of a band",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W1: {emphasise: 20}}}"),
    "weight-band-negative": Broken(16, "design.weights.W1.emphasise.0", "-5", "in Hz of at least 0",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W1: {emphasise: [-5, 20]}}}"),
    "weight-band-beyond-ticks": Broken(16, "design.weights.W1.emphasise", "a band up to 600 Hz", "at most 500 Hz",
        "design: {coupling: spring-damper, objective: loop-shaping, weights: {W1: {emphasise: [0, 600]}}}"),
    "tau-negative": Broken(16, "design.tau", "-0.0001", "in s from 0 to 0.1",
        "design: {coupling: spring-damper, tau: -0.0001}"),
    "tau-above-period": Broken(16, "design.tau", "0.002 with a period of 0.001 s", "at most the period",
        "design: {coupling: spring-damper, tau: 0.002}"),
    "tau-in-milliseconds": Broken(16, "design.tau", "'0.3 ms'", "a number in s, without the unit",
        "design: {coupling: spring-damper, tau: 0.3 ms}"),
    "given-unasked": Broken(16, "design.stiffness", "with 'coupling: spring-damper'", "'coupling: given'",
        "design: {coupling: spring-damper, stiffness: 700}"),
    "given-without-values": Broken(16, "design", "without anything given", "stiffness", "design: {coupling: given}"),
    "given-twice": Broken(16, "design.matrices", "besides stiffness", "either",
        "design: {coupling: given, stiffness: 700, matrices: {cx: {A: [], B: [], C: [], D: [[1]]}}}"),
    "given-outside-block": Broken(16, "design.stiffness.0.1", "5 between 'dx' of coupling 'cx' and 'dy'", "0 between",
        "design: {coupling: given, stiffness: [[700, 5], [5, 700]], damping: 0.04}"),
    "given-unsymmetric": Broken(15, "design.stiffness.1.0", "4.0 in row 2, column 1", "symmetric",
        {7: "  c: {devices: [dx, dy]}", 8: None,
        16: "design: {coupling: given, stiffness: [[700, 5], [4, 700]], damping: 0.04}"}),
    "given-not-positive": Broken(16, "design.stiffness", "the eigenvalue -700", "positive definite",
        "design: {coupling: given, stiffness: -700}"),
    "given-wrong-size": Broken(16, "design.stiffness", "3 numbers", "for the ports dx, dy",
        "design: {coupling: given, stiffness: [700, 700, 700]}"),
    # wave links
    "wave-link-neither": Broken(7, "couplings.cx.wave_link", "neither mass nor b", "mass, the felt mass allowed, or b",
        "  cx: {devices: [dx], wave_link: {round_trip: 0.01}}", base=WAVES),
    "wave-link-both": Broken(7, "couplings.cx.wave_link", "both mass and b", "one of the two",
        "  cx: {devices: [dx], wave_link: {mass: 0.1, b: 20, round_trip: 0.01}}", base=WAVES),
    "wave-link-without-round-trip": Broken(7, "couplings.cx.wave_link", "mass without round_trip", "round_trip, in s",
        "  cx: {devices: [dx], wave_link: {mass: 0.1}}", base=WAVES),
    "wave-link-mass-zero": Broken(7, "couplings.cx.wave_link.mass", "0", "a felt mass in kg greater than 0",
        "  cx: {devices: [dx], wave_link: {mass: 0, round_trip: 0.01}}", base=WAVES),
    "wave-link-mass-matrix": Broken(8, "couplings.cy.wave_link.mass", "a matrix", "one for each port",
        "  cy: {devices: [dy], wave_link: {mass: [[1, 0.5], [0.5, 1]], round_trip: 0.01}}", base=WAVES),
    "wave-link-b-count": Broken(8, "couplings.cy.wave_link.b", "3 numbers", "for the ports dy.0, dy.1",
        "  cy: {devices: [dy], wave_link: {b: [20, 20, 20]}}", base=WAVES),
    "wave-link-b-indefinite": Broken(8, "couplings.cy.wave_link.b", "the eigenvalue -10", "positive definite",
        "  cy: {devices: [dy], wave_link: {b: [[20, 30], [30, 20]]}}", base=WAVES),
    "wave-link-b-unsymmetric": Broken(8, "couplings.cy.wave_link.b.1.0", "2.0 in row 2, column 1", "symmetric",
        "  cy: {devices: [dy], wave_link: {b: [[20, 1], [2, 20]]}}", base=WAVES),
    "wave-link-round-trip": Broken(7, "couplings.cx.wave_link.round_trip", "11", "greater than 0 and at most 10",
        "  cx: {devices: [dx], wave_link: {b: 20, round_trip: 11}}", base=WAVES),
    "wave-link-tank": Broken(7, "couplings.cx.wave_link.tank", "-1", "a tank in J from 0 to 10",
        "  cx: {devices: [dx], wave_link: {b: 20, tank: -1}}", base=WAVES),
    "wave-link-depth": Broken(7, "couplings.cx.wave_link.depth", "1.5", "a whole number of ticks",
        "  cx: {devices: [dx], wave_link: {b: 20, depth: 1.5}}", base=WAVES),
    "wave-link-harvest": Broken(7, "couplings.cx.wave_link.harvest", "-0.1", "a harvest in N·s/m of at least 0",
        "  cx: {devices: [dx], wave_link: {b: 20, harvest: -0.1}}", base=WAVES),
    "wave-link-harvest-count": Broken(8, "couplings.cy.wave_link.harvest", "3 numbers", "for the ports dy.0, dy.1",
        "  cy: {devices: [dy], wave_link: {b: 20, harvest: [0.1, 0.1, 0.1]}}", base=WAVES),
    "wave-link-ladder": Broken(17, "design.ladder", "delays with a wave link at every coupling", "no ladder",
        {7: "  cx: {devices: [dx], wave_link: {b: 20}}", 8: "  cy: {devices: [dy], wave_link: {b: 20}}",
        17: "design: {coupling: spring-damper, ladder: [0.0005]}"}, base=WAVES),
    "wave-link-tau": Broken(7, "couplings.cx.wave_link.tau", "0.0005 with a period of 0.00025 s", "at most the period",
        "  cx: {devices: [dx], wave_link: {b: 20, period: 0.00025, tau: 0.0005}}", base=WAVES),
    "wave-link-tau-of-design": Broken(7, "couplings.cx.wave_link.period", "0.001 with a period of 0.00025 s", "a tau",
        {7: "  cx: {devices: [dx], wave_link: {b: 20, period: 0.00025}}",
        17: "design: {coupling: spring-damper, tau: 0.001}"}, base=WAVES),
    "wave-link-key": Broken(7, "couplings.cx.wave_link.roundtrip", "unknown key 'roundtrip'",
        "did you mean 'round_trip'?",
        "  cx: {devices: [dx], wave_link: {b: 20, roundtrip: 0.01}}", base=WAVES),
    "wave-link-part-of-device": Broken(9, "couplings.cz.wave_link", "only some of the ports", "whole devices",
        {7: "  cx: {devices: [dx], wave_link: {b: 20}}",
        8: "  cy: {ports: [dy.0]}\n  cz: {ports: [dy.1], wave_link: {b: 20}}"}, base=WAVES),
    "wave-link-transparency": Broken(17, "design.objective", "loop-shaping with the wave link", "feasible or stiffest",
        {7: "  cx: {devices: [dx], wave_link: {b: 20}}",
        17: "design: {coupling: spring-damper, objective: loop-shaping}"}, base=WAVES),
    "wave-link-uncoupled": Broken(17, "design.coupling", "'coupling: none' with the wave link of 'cx'", "a coupling",
        {7: "  cx: {devices: [dx], wave_link: {b: 20}}", 17: "design: {coupling: none}"}, base=WAVES),
    "matrices-missing-block": Broken(16, "design.matrices", "no matrices for 'cy'", "cx, cy",
        "design: {coupling: given, matrices: {cx: {A: [], B: [], C: [], D: [[1]]}}}"),
    "matrices-unknown-block": Broken(16, "design.matrices.cz", "unknown coupling 'cz'", "one of cx, cy",
        "design: {coupling: given, matrices: {cx: {A: [], B: [], C: [], D: [[1]]}, "
        "cz: {A: [], B: [], C: [], D: [[1]]}}}"),
    "matrices-shape": Broken(20, "design.matrices.cy.B", "a matrix of 1 x 2", "1 x 1, with 1 states and 1 ports",
        {16: "design:\n  coupling: given\n  matrices:\n    cx: {A: [], B: [], C: [], D: [[1]]}\n"
            "    cy: {A: [[0.5]], B: [[1, 1]], C: [[1]], D: [[1]]}"}),
    # observers
    "observers-list": Broken(17, "observers", "a list of 1", "0 to 32 entries, each an observer name",
        {16: "design: {coupling: spring-damper}\nobservers: [watch]"}),
    "observer-name": Broken(17, "observers.Watch", "'Watch'", "a lowercase letter",
        {16: "design: {coupling: spring-damper}\nobservers: {Watch: {reads: [telemetry]}}"}),
    "observer-reserved-name": Broken(17, "observers.ground", "reserved", "other than environment, supervisor, ground",
        {16: "design: {coupling: spring-damper}\nobservers: {ground: {reads: [telemetry]}}"}),
    "observer-named-as-device": Broken(17, "observers.dy", "'dy' of a device", "no device or coupling has",
        {16: "design: {coupling: spring-damper}\nobservers: {dy: {reads: [telemetry]}}"}),
    "observer-named-as-coupling": Broken(17, "observers.cy", "'cy' of a coupling", "no device or coupling has",
        {16: "design: {coupling: spring-damper}\nobservers: {cy: {reads: [telemetry]}}"}),
    "observer-without-reads": Broken(17, "observers.watch", "no key 'reads'", "what it may read",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {}}"}),
    "observer-writes": Broken(17, "observers.watch.writes", "unknown key 'writes'", "reads",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {reads: [telemetry], writes: [dx/force]}}"}),
    "observer-reads-nothing": Broken(17, "observers.watch.reads", "an empty list", "a list of 1 to 4096 channels",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {reads: []}}"}),
    "observer-reads-word": Broken(17, "observers.watch.reads", "'telemetry'", "a list of 1 to 4096 channels",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {reads: telemetry}}"}),
    "observer-reads-number": Broken(17, "observers.watch.reads.0", "7", "telemetry, or NODE/CHANNEL",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {reads: [7]}}"}),
    "observer-reads-everything": Broken(17, "observers.watch.reads.0", "'all'", "NODE/CHANNEL such as dx/telemetry",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {reads: [all]}}"}),
    "observer-reads-twice": Broken(22, "observers.watch.reads.2", "the channel 'dx/sample' twice", "each channel once",
        {16: "design: {coupling: spring-damper}\nobservers:\n  watch:\n    reads:\n"
            "      - dx/sample\n      - telemetry\n      - dx/sample"}),
    "observer-unknown-node": Broken(17, "observers.watch.reads.1", "node 'dxx' in 'dxx/sample'", "(did you mean 'dx'?)",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {reads: [telemetry, dxx/sample]}}"}),
    "observer-unknown-channel": Broken(17, "observers.watch.reads.0", "'samples' of 'dx'",
        "(did you mean 'dx/sample'?)",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {reads: [dx/samples]}}"}),
    "observer-reads-tool": Broken(17, "observers.watch.reads.0", "'tool' of 'dx'", "dx/sample, dx/force, dx/telemetry",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {reads: [dx/tool]}}"}),
    "observer-reads-force": Broken(17, "observers.watch.reads.0", "'force' of 'cx'", "cx/reaction, cx/telemetry",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {reads: [cx/force]}}"}),
    "observer-reads-environment": Broken(17, "observers.watch.reads.0", "of 'environment'", "environment/telemetry",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {reads: [environment/tool]}}"}),
    "observer-reads-control": Broken(17, "observers.watch.reads.0", "'control' of 'dx'",
        "dx/sample, dx/force, dx/telemetry",
        {16: "design: {coupling: spring-damper}\nobservers: {watch: {reads: [dx/control]}}"}),
}  # fmt: skip
"""By the name of the file."""
