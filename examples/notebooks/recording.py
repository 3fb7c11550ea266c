# %% [markdown]
# # What a recording tells
#
# A session of seven processes is run and recorded. Then the recording alone says who took part, under which
# certificate, what every party saw, and whether each kept its promise.

# %%
import numpy as np
from matplotlib import pyplot as plt

import manyhands as mh

# %% [markdown]
# ## A run to look at
#
# `run` starts the real processes for as long as the block lasts. Under the simulated clock they run as fast as they
# can, with the same numbers on every machine; leave the clock out for a run in real time.

# %%
with mh.run("example1", 1.0, clock="simulated", record="run.mcap") as session_run:
    print(sorted(session_run.progress.states))
    session_run.wait()
print(session_run)

# %%
run = mh.read("run.mcap")
print(run)
assert run.cut is None  # the file is whole

# %% [markdown]
# ## Who took part, and under which certificate
#
# The recording holds the session as it ran, and its certificate. Nobody has to be believed: the certificate is proved
# again.

# %%
print({name: role.value for name, role in run.recorded.roles.items()})
with open("certificate.json", "wb") as file:
    file.write(run.attachments["certificate.json"])
proof = mh.verify("certificate.json", "example1")
print(proof)
assert proof

# %% [markdown]
# ## What everybody saw
#
# Every topic of every node is a column of one table, by the name `NODE.TOPIC[COLUMN]_UNIT`. `run.columns()` is a dict
# of numpy arrays, `run.to_pandas()` a data frame where pandas is installed, and `run.save("run.parquet")` a file.

# %%
table = run.columns("dx", "environment/masses")
for name, values in table.items():
    print(f"{name:32} {len(values)} rows, up to {np.nanmax(np.abs(values)):.3g}")

# %% [markdown]
# The velocity is computed from the positions. Three hands push one hub, one after the other:

# %%
figure, (above, middle, below) = plt.subplots(3, 1, sharex=True, figsize=(8.0, 7.0), layout="constrained")
mh.plot(run, "velocity", ax=above)
mh.plot(run, "force", ax=middle)
mh.plot(run, "ledger", ax=below)
figure.savefig("recording.png")
print(f"fastest hand: {abs(run.velocity).max():.3f} m/s")

# %% [markdown]
# ## Who kept which promise
#
# Each party keeps a *ledger*: the energy that it took in, less what its promise allows it. A ledger that falls below 0
# is a broken promise, of that party and of nobody else. Here the least of each is 0, to rounding.

# %%
ledgers = run.columns("*/ledger")
for name, values in list(ledgers.items())[2:]:
    print(f"{name}: least {values.min():.1e} J, in the end {values[-1]:.2e} J")
    assert values.min() > -1e-12

# %% [markdown]
# ## Is it what the session computes?
#
# The simulation in one process uses the same cores. It must agree with the seven processes bit for bit, and so a
# recording can be checked against the session that it claims to be of. `manyhands audit run.mcap` does this for every
# node and every promise.

# %%
again = mh.simulate("example1", 1.0)
assert np.array_equal(again.x, run.x)
assert np.array_equal(again.f_v, run.f_v)
print(f"{again.x.size} positions and forces agree bit for bit")
