# %% [markdown]
# # Stiffness against delay
#
# A virtual spring that is computed once a millisecond is late, and lateness feeds energy into the hand. How stiff may a
# coupling be, for which delay, and what does a shorter period buy? The session is the paper's Example 1: three devices
# with 1.37 N·s/m each.

# %%
import numpy as np
from matplotlib import pyplot as plt

import manyhands as mh

session = mh.load("example1")
T = session.period

# %% [markdown]
# ## Before any design: the budget
#
# The budget is the stiffness that can be certified, over the delay τ between the sample of a position and the instant
# at which its force acts. Beside it stands Colgate's limit: what one device can render of a wall whose delay never
# changes. Nothing is designed for this.

# %%
budget = mh.budget(session)
for tau in (0.0, 0.25e-3, 0.5e-3, 1e-3):
    row = budget.at(tau)["dx"]
    print(f"tau = {1e3 * tau:.2f} ms: {row.certified:4.0f} N/m certified, Colgate's limit {row.colgate:4.0f} N/m")

# %% [markdown]
# Without delay the two meet, at 2740 N/m. With half a tick of delay 1096 N/m are left of Colgate's 1370 N/m: our limit
# holds for any number of users, for delays that change from tick to tick, and for every passive environment. In closed
# form it is Δ_D/(T/2 + 3τ/2):

# %%
for tau in (0.0, 0.25e-3, 0.5e-3, 1e-3):
    assert np.isclose(budget.at(tau)["dx"].certified, 1.37 / (T / 2 + 1.5 * tau), rtol=1e-6)

# %% [markdown]
# ## The design keeps the promise
#
# For each delay the stiffest coupling is designed and proved. It reaches the budget, except for the little that a proof
# in exact arithmetic needs and that is kept in reserve.

# %%
delays = [0.0, 0.1e-3, 0.2e-3, 0.3e-3, 0.5e-3, 0.75e-3, 1e-3]
reached = []
for tau in delays:
    changes = {"design.objective": "stiffest", "design.tau": tau, "design.ladder": []}
    certificate = mh.certify(session.replace(changes))
    reached.append(certificate.stiffness[0, 0])
    limit = budget.at(tau)["dx"].certified
    print(f"tau = {1e3 * tau:.2f} ms: {reached[-1]:4.0f} of {limit:4.0f} N/m, {100 * reached[-1] / limit:.1f} %")
    assert 0.97 * limit < reached[-1] < limit

# %%
figure, ax = plt.subplots(layout="constrained")
mh.plot(budget, "dx", ax=ax)
ax.plot(1e3 * np.array(delays), reached, "kx", label="designed")
figure.savefig("stiffness_and_delay.png")

# %% [markdown]
# ## What a shorter period buys
#
# Everything scales with the period: at half a millisecond, and with the delay halved too, the limit doubles to
# 5480 N/m. A delay that stays as it is costs more and more of what a shorter period gains.

# %%
for period, tau in ((1e-3, 0.0), (0.5e-3, 0.0), (1e-3, 0.3e-3), (0.5e-3, 0.3e-3), (0.25e-3, 0.25e-3)):
    print(f"T = {1e3 * period:.2f} ms, tau = {1e3 * tau:.2f} ms: {budget.at(tau, period)['dx'].certified:4.0f} N/m")

# %% [markdown]
# ## What it feels like
#
# Three users push the hub. With the coupling for half a tick of delay the tools lag further behind the hands: this is
# what a delay costs the person.

# %%
for tau in (0.0, 0.5e-3):
    changed = session.replace({"design.objective": "stiffest", "design.tau": tau, "design.ladder": []})
    run = mh.simulate(changed, 1.0)
    tools = np.column_stack([run.columns("environment/tools")[f"environment.tools[{port}]_m"] for port in run.ports])
    print(f"tau = {1e3 * tau:.1f} ms: hand and tool up to {1e3 * abs(run.x - tools).max():.2f} mm apart")
