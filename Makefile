# On a fresh machine with Python >= 3.11 and make, nothing else: `make demo` and `make test`.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin

ROUNDS ?= 10

.PHONY: walks container service ssh nat pythons demo test test-long test-rest guests lint types imports pytest campaign attack heavy refusals worlds fuzz fuzz-board firmware datagrams wan far-user scenes world-peers encoder friction mechanisms identify orientation six-axes turning-bodies flood loop watched soak users linked-users chaos faults lateness inertia honest hostile blamed device-faults remote pictures page benchmark curve figures docs words docs-pictures clean

demo: $(VENV)/.installed
	$(BIN)/manyhands demo -o out/demo

test: lint types imports pytest

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed
	$(BIN)/mypy

imports: $(VENV)/.installed
	$(BIN)/lint-imports

# what judges sessions in real time runs alone; the rest in so many processes, 0 being none beside this one: one more than
# the two processors that it is meant for, because tests of real processes wait a third of their time
WORKERS ?= 3
# the order is tests/conftest.py's; a test that waits for ever ends the run (pyproject.toml), and is not begun again
SPREAD  := --dist loadfile --no-loadscope-reorder --max-worker-restart 0
# collecting the other files would take twenty seconds; looked up where it is used alone
ALONE    = $(shell grep -rl --include='test_*.py' 'mark\.alone' tests)
# matrices of ten rows: more threads in BLAS only wait for each other, and for the other test process
pytest test-long test-rest campaign attack refusals worlds scenes world-peers mechanisms identify orientation six-axes turning-bodies: export OMP_NUM_THREADS = 1
pytest test-long test-rest campaign attack refusals worlds scenes world-peers mechanisms identify orientation six-axes turning-bodies: export OPENBLAS_NUM_THREADS = 1
# where it is set, every process of every session that a test starts would compile the product and the tests anew
pytest test-long test-rest campaign attack: export PYTHONDONTWRITEBYTECODE =
pytest: $(VENV)/.installed
	$(BIN)/pytest -n $(WORKERS) $(SPREAD) -m "not alone and not long"
	$(BIN)/pytest -m "alone and not long" $(ALONE)

# what `make test` leaves out: tests that take long, and wider searches of random cases
test-long campaign: export MANYHANDS_WIDE = 1
test-long: $(VENV)/.installed
	$(BIN)/pytest -n $(WORKERS) $(SPREAD) -m "(long or wide) and not alone"
	$(BIN)/pytest -m "(long or wide) and alone and not minutes" $(ALONE)

# what `make test` leaves out, for it takes long, but the wide searches; CI runs it after `make test`
test-rest: $(VENV)/.installed
	$(BIN)/pytest -n $(WORKERS) $(SPREAD) -m "long and not alone"
	$(BIN)/pytest -m "long and alone and not minutes" $(ALONE)

# guests who come and go by real processes across a WAN: in every phase, and twenty at random; ten minutes
guests: $(VENV)/.installed
	$(BIN)/pytest -m minutes tests/system/test_seats.py

# every driver on its fake in real time, from identify to a wall that is felt; forty minutes, and nothing else may run
walks: $(VENV)/.installed
	$(BIN)/pytest -rPs -o faulthandler_timeout=2400 -m long tests/system/test_identify.py

# properties of the mathematics, the codec and session files with new random cases in each round; not part of `make test`.
# Then the attack: so many certificates that `prove` accepts, designed and forged, against an oracle of other code
CLAIMS  ?= 100000
MINUTES ?= 120
campaign: $(VENV)/.installed
	for round in $$(seq $(ROUNDS)); do \
		$(BIN)/pytest -q --hypothesis-profile=campaign tests/design tests/protocol tests/launch/session/test_properties.py || exit 1; \
	done
	MANYHANDS_UNMOVED_SESSIONS=120 $(BIN)/pytest -q tests/design/test_unmoved_masses.py
	$(BIN)/python -m tests.attack.campaign --claims $(CLAIMS) --seconds $$(($(MINUTES) * 60)) --processes 2 --seed $(SEED)

# the attack on one kind of certificates alone; by default on those that count the world's springs in series
KIND ?= series
attack: $(VENV)/.installed
	$(BIN)/python -m tests.attack.campaign --kind "$(KIND)" --claims $(CLAIMS) --seconds $$(($(MINUTES) * 60)) --processes 2 --seed $(SEED)

# hostile files of up to 1 MB, of every shape: each is proved, or refused beforehand, within ten seconds of a processor
FILES ?= 1000
heavy: $(VENV)/.installed
	$(BIN)/python -m tests.attack.heavy --files $(FILES) --seed $(SEED)

# random sessions that are refused: every printed remedy is applied as it is printed, accepted, and gives what it states;
# every stated limit is within 1 % of where design begins to refuse: half an hour on one core
REFUSALS ?= 200
refusals: $(VENV)/.installed
	$(BIN)/python -m benchmarks.refusals --refusals $(REFUSALS) --seed $(SEED)

# 500 random worlds with poles from 0.01 to 1000/s, against an LMI of other code, and 500 networks whose stiffnesses span up
# to 22 decades: twenty minutes
WORLDS ?= 500
worlds: $(VENV)/.installed
	MANYHANDS_SEARCHED=$(WORLDS) $(BIN)/pytest tests/design/test_rational_worlds.py tests/design/test_far_apart.py

# coverage-guided fuzzing of all that strangers can send, ten minutes at the default; see tests/fuzz/README.md
FUZZ_SECONDS ?= 600
fuzz: $(VENV)/.installed
	$(BIN)/pip install --quiet 'atheris>=2.3'
	$(BIN)/python tests/fuzz/run.py $(FUZZ_SECONDS)

# the firmware's core of a serial board under the sanitizers, ten minutes at the default; `make fuzz` has the host's end
fuzz-board:
	mkdir -p out && $(CC) -std=c99 -Wall -Wextra -Werror -O2 -g -fsanitize=address,undefined -fno-sanitize-recover=all \
		-Idevices/serial_board/firmware tests/fakes/fuzz_mhb.c devices/serial_board/firmware/mhb.c -lm -o out/fuzz-mhb
	out/fuzz-mhb $(FUZZ_SECONDS) $(SEED)

# the serial board's firmware on an emulated Cortex-M3: needs gcc-arm-none-eabi, libnewlib-arm-none-eabi, qemu-system-arm
firmware: $(VENV)/.installed
	MANYHANDS_REQUIRE_ARM=1 $(BIN)/pytest tests/devices/serial_board/test_arm.py

# what a datagram costs to seal, open and refuse, and a stranger's flood before the port: a minute
datagrams: $(VENV)/.installed
	$(BIN)/python benchmarks/datagrams.py

# the age of the newest wave across a WAN of namespaces, with datagrams and with ZeroMQ alone: three minutes
wan: $(VENV)/.installed
	$(BIN)/python -m tests.support.path_ends 20

# the image of deploy/Containerfile upon Debian's own packages, and what it does; as root, with mmdebstrap, buildah, podman
# and crun: ten minutes
container: $(VENV)/.installed
	$(BIN)/python -m tests.deployed.image

# systemd's own checks of the unit: a few seconds
service: $(VENV)/.installed
	$(BIN)/python -m tests.deployed.service

# `launch --on` through a real sshd on a port of the loopback, with throw-away keys; needs openssh-server: a minute
ssh: $(VENV)/.installed
	$(BIN)/python -m tests.deployed.ssh

# guests and hosts behind routers that translate addresses, in namespaces; as root, with nftables: two minutes
nat: $(VENV)/.installed
	$(BIN)/python -m tests.deployed.router

# the suite on Python 3.11 to 3.14, of PATH, pyenv or Debian (as root, with mmdebstrap): the whole one takes hours;
# SUITE="tests/protocol tests/nodes" names tests in its place, ONLY="--only 3.14" a version
pythons: $(VENV)/.installed
	$(BIN)/python -m tests.deployed.pythons $(ONLY) $(SUITE)

# three users of Example 1, one across a WAN of namespaces, beside an ideal line; exits 1 when a bound is broken. On a
# machine that does nothing else; four minutes
far-user: $(VENV)/.installed
	$(BIN)/python -m tests.support.far_user 60

# 500 random scenes with contacts and friction in closed loop, every account checked: about three minutes. Then tools on
# the axes, edges, corners and faces of every pair of shapes, 100,000 searched steps: three minutes. Then 500 scenes with
# devices in wall time, within the certified delay and far beyond, and hostile hands: ten minutes
scenes: $(VENV)/.installed
	MANYHANDS_SCENES=500 $(BIN)/pytest -n $(WORKERS) tests/launch/audit/test_simulation_scene.py
	$(BIN)/python -m tests.deterministic.edges --steps 100000 --seed $(SEED)
	$(BIN)/python -m tests.deterministic.lateness --scenes --sessions 500 --ticks 500 --seed $(SEED)

# a wall and stones rendered by ours and as others do it, in the same hands, in simulated time; exits 1 if one of ours gives
# a hand energy: ten minutes on one core
world-peers: $(VENV)/.installed
	$(BIN)/python -m benchmarks.world_peers --rest --markdown docs/worlds.md
	$(BIN)/python -m benchmarks.world_peers --json docs/world-peers.json --plot docs/images/world-peers.png --markdown docs/worlds.md

# 1000 random linear loops whose devices measure in steps, and hands that look for energy in them; exits 1 if one is given
# any although dry friction covers the steps, or if single springs give none with 2/3 of that friction: 20 minutes
encoder: $(VENV)/.installed
	$(BIN)/python -m benchmarks.encoder --seed $(SEED)

# 1000 random devices with dry friction at springs that are proved below a speed, and hands that look for energy in them;
# exits 1 if an account is below its bound, or anything is enforced below that speed at covered delays: 10 minutes
friction: $(VENV)/.installed
	$(BIN)/python -m benchmarks.friction --seed $(SEED)

# random devices of known damping, friction and linkages, identified in simulated time: no lower end may be above the truth;
# a quarter of an hour
DEVICES ?= 200
identify: $(VENV)/.installed
	$(BIN)/python -m benchmarks.identify --devices $(DEVICES) --seed $(SEED)

# hands that turn violently, and worlds that propose anything, against the law of orientations; half an hour. Then hostile
# hands of six axes in MuJoCo, 120,000 ticks: two minutes. Then 500 sessions with such devices in wall time, within the
# certified delay and far beyond: ten minutes. Then a god-object and a midpoint body beside it, in the hands of the same:
# six minutes
MOTIONS ?= 100000
THROWN  ?= 120000
orientation: $(VENV)/.installed
	$(BIN)/python -m benchmarks.orientation --motions $(MOTIONS) --seed $(SEED)
	$(BIN)/python -m tests.deterministic.turned --ticks $(THROWN) --seed $(SEED)
	$(BIN)/python -m tests.deterministic.late_turns --sessions 500 --seed $(SEED)
	$(BIN)/python -m benchmarks.orientation_peers --markdown docs/decisions/0054-orientation.md

# bodies that turn in a scene of its own (decision 55): which schemes give out energy, in a million steps each: nine
# minutes; and what the tests cost hands of six axes in such a scene: six minutes
turning-bodies: $(VENV)/.installed
	$(BIN)/python -m benchmarks.turning_bodies --seed $(SEED)
	$(BIN)/python -m tests.deterministic.turned_in_a_scene --seed $(SEED)

# the environment's step with two tools of six axes and ten contacts, in MuJoCo; exits 1 above 500 us at p99: a minute
six-axes: $(VENV)/.installed
	$(BIN)/python -m benchmarks.six_axes

# what held torques, encoder steps and dry friction do to a certified stiffness: a minute and a half
mechanisms: $(VENV)/.installed
	$(BIN)/python -m benchmarks.mechanisms --images docs/images --markdown docs/mechanisms.md

# what honest nodes feel of a rogue that sends as fast as it can: about ten minutes
flood: $(VENV)/.installed
	$(BIN)/python benchmarks/flood.py --json docs/flood.json

# a tick's latency beside bare pyzmq and other middleware, in the same run: a quarter of an hour; peers go into out/peers-venv
loop: $(VENV)/.installed
	$(BIN)/python benchmarks/loop.py --install
	$(BIN)/python benchmarks/loop.py --json docs/loop-benchmark.json --plot docs/images/loop-latency.png --markdown docs/loop-benchmark.md

# what the loop feels of its recorder, top and page, alone, together and stopped: about ten minutes
watched: $(VENV)/.installed
	$(BIN)/python benchmarks/watched.py --json docs/loop-watched.json --markdown docs/loop-benchmark.md

# hundreds of faults at random, in both clocks; exits 1 when one of the invariants does not hold
chaos: $(VENV)/.installed
	$(BIN)/python benchmarks/chaos.py --json docs/chaos.json --markdown docs/faults.md

# thousands of faults in sessions that are simulated with all their loops, links and conductor; a failing seed runs again
FAULTS ?= 4000
SEED   ?= 1
faults: $(VENV)/.installed
	$(BIN)/python -m tests.deterministic.campaign --faults $(FAULTS) --a-run 20 --seed $(SEED)

# a thousand random sessions whose devices live in wall time, within the certified delay and far beyond: half an hour
SESSIONS ?= 1000
lateness: $(VENV)/.installed
	$(BIN)/python -m tests.deterministic.lateness --sessions $(SESSIONS) --ticks 2000 --seed $(SEED)

# an adversary within a device's stated mass and its hand's force, 100,000 searched ticks: two minutes
TICKS ?= 100000
inertia: $(VENV)/.installed
	$(BIN)/python -m tests.deterministic.inertia --ticks $(TICKS) --seed $(SEED)

# a hundred honest sessions in real time with faults, open clutches and freezing, recorded and audited: five minutes
RECORDINGS ?= 100
honest: $(VENV)/.installed
	$(BIN)/python -m tests.deterministic.honest --recordings $(RECORDINGS) --seed $(SEED)

# waves of any magnitude at the faces of wave links, a million ticks with exact accounts; guests behind wave links who send
# what they like; hostile guests within their bounds in simulated sessions, and honest ones that may not notice; a failing
# seed runs again. Then 200 hostile parties of any kind: no honest party may be named for what they do
RUNS ?= 1000
hostile: $(VENV)/.installed
	$(BIN)/python -m tests.deterministic.magnitudes --seed $(SEED)
	$(BIN)/python -m tests.deterministic.seats --seed $(SEED)
	$(BIN)/python -m tests.deterministic.hostile --runs $(RUNS) --seed $(SEED)
	$(BIN)/python -m tests.deterministic.hostile --runs 200 --seed $(SEED) --honest
	$(BIN)/python -m tests.deterministic.blame --runs 200 --seed $(SEED)

# twenty hostile guests in real processes over encrypted sockets: no honest party may be named for what they do, and the
# guest is; a quarter of an hour
GUESTS ?= 20
blamed: $(VENV)/.installed
	$(BIN)/python -m tests.system.blame --runs $(GUESTS) --seed $(SEED)

# faults of real devices in real sessions, whose drivers talk to fakes: what their motors do, who is named for it, what
# comes back, and the recordings' audits; five minutes for each device
DEVICE_FAULTS ?= 104
device-faults: $(VENV)/.installed
	$(BIN)/python -m tests.system.device_faults --faults $(DEVICE_FAULTS) --seed $(SEED) $(if $(DEVICE),--device $(DEVICE))

# a remote user over every kind of network, beside what others do, in simulated time: five minutes on two idle cores
remote: $(VENV)/.installed
	$(BIN)/python -m benchmarks.remote --json docs/remote.json --plot docs/images/remote.png --markdown docs/remote/figures.md

# memory of a session's processes over ten minutes
soak: $(VENV)/.installed
	$(BIN)/python benchmarks/loop.py --soak 600 --json docs/loop-soak.json --markdown docs/loop-benchmark.md

# how many users one environment serves at 1 kHz, and where its time goes: ten minutes
users: $(VENV)/.installed
	$(BIN)/python benchmarks/users.py --profile --json docs/loop-users.json --plot docs/images/loop-users.png --markdown docs/loop-benchmark.md

# the same for users behind wave links, with a wave in every tick and in every fourth, pure and compiled: half an hour
linked-users: $(VENV)/.installed
	$(BIN)/python benchmarks/linked_users.py --install
	$(BIN)/python benchmarks/linked_users.py --compiled --json docs/linked-users.json --plot docs/images/linked-users.png --markdown docs/loop-benchmark.md

# what docs/images/ shows of the architecture and the design; the linear couplings' search takes about half a minute
pictures: $(VENV)/.installed
	$(BIN)/manyhands graph example1.yaml --format svg -o docs/images/architecture.svg
	$(BIN)/manyhands budget example1.yaml --plot docs/images/budget.png
	$(BIN)/manyhands design example2-linear.yaml --plot out/design
	cp out/design/singular-values.png docs/images/design-singular-values.png

# the page of a session in Chromium, which must be there: its tests, their pictures in out/page/, and docs/images/page*.png
page: $(VENV)/.installed
	MANYHANDS_REQUIRE_BROWSER=1 $(BIN)/pytest -q tests/system/test_page*.py
	$(BIN)/python -m tests.system.page_picture
	$(BIN)/python -m tests.system.page_gallery out/page/sessions docs/images/page-sessions.png

# design time against ports, beside a plain transcription of the paper; an hour at the default limit
LIMIT ?= 600
benchmark: $(VENV)/.installed
	$(BIN)/python benchmarks/design.py --limit $(LIMIT)

# transparency against the order of linear couplings, the table of docs/design.md: about ten minutes
curve: $(VENV)/.installed
	$(BIN)/python examples/order_curve.py

# an editable installation is never compiled, so pip need not fetch what compiles
$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	HATCH_BUILD_NO_HOOKS=true $(BIN)/pip install --quiet --editable '.[dev]'
	touch $@

# SPEC.md's table of figures, from their declarations
figures: $(VENV)/.installed
	$(BIN)/python -m tests.support.spec_text

# the documentation as a site, in out/docs/; a broken link or a page that is not listed ends it
docs: $(VENV)/.installed
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet --conf-dir docs/site . out/docs

# how much there is to read, and what the site's search finds for a newcomer's words; needs Debian's Chromium
words: $(VENV)/.installed
	$(BIN)/python -m benchmarks.words

# pictures of ten pages of the site, on a screen and on a telephone, in out/docs-pictures/; needs Debian's Chromium
docs-pictures: $(VENV)/.installed
	$(BIN)/python -m tests.support.site out/docs-pictures

clean:
	rm -rf $(VENV) out dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
