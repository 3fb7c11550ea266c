# %% [markdown]
# # A coupling for a plant of one's own
#
# You have a haptic device of which you know a model, and something virtual to touch of which you know a transfer
# function. This notebook leads from these two to a certified virtual coupling, and to its numbers in SciPy.
#
# The file is a notebook in the percent format: an editor that knows it (VS Code, Spyder, PyCharm, Jupyter with
# jupytext) shows cells, and `python own_plant.py` runs it as a script.

# %%
import numpy as np
import scipy.signal
from matplotlib import pyplot as plt

import manyhands as mh

T = 0.001  # s

# %% [markdown]
# ## The device
#
# A motor of 0.25 kg moves a handle of 0.1 kg through a transmission of 40 kN/m. The motor has 1.8 N·s/m of friction,
# the transmission 2 N·s/m. From motor force to motor velocity:

# %%
M, m, b, k, c = 0.25, 0.1, 1.8, 40e3, 2.0
device = scipy.signal.StateSpace(
    [
        [-(b + c) / M, c / M, -k / M],
        [c / m, -c / m, k / m],
        [1.0, -1.0, 0.0],
    ],  # velocities; stretch of the transmission
    [[1.0 / M], [0.0], [0.0]],
    [[1.0, 0.0, 0.0]],
    [[0.0]],
)

# %% [markdown]
# What the coupling can count on is the device's *output strict passivity*: at least how much it dissipates, as the
# damping Δ_D of an equivalent damper. The transmission cannot add to it in the worst case, so that only the friction
# is left, 1.80 N·s/m. Lemma 1 of the paper finds that number, with a storage function as the proof:

# %%
level = mh.passivity.device_level(mh.passivity.StateSpace.of(device))
print(f"Delta_D = {level.value:.2f} N·s/m")

# %% [markdown]
# ## What is touched
#
# A gel that is soft at rest and stiff when it is struck, from displacement (m) to force (N):
#
#     E(s) = 4000 (s + 20)/(s + 160)
#
# At rest it is a spring of 500 N/m; far above 160 rad/s it is one of 4000 N/m.

# %%
gel = scipy.signal.TransferFunction([4000.0, 4000.0 * 20.0], [1.0, 160.0])
print(f"{gel.to_ss().D[0, 0]:.0f} N/m when struck, {gel.num[-1] / gel.den[-1]:.0f} N/m at rest")

# %% [markdown]
# ## The session
#
# A session is one mapping, the same as in a session file (docs/session-file.md). Systems of SciPy and of
# python-control can stand in it as they are. We state a level a little below the one that was found, because a model
# is never the device.

# %%
session = mh.Session.from_dict(
    {
        "session": "gel",
        "period": T,
        "devices": {
            "pen": {
                "dof": 1,
                "osp": 0.9 * level.value,
                "driver": "simulated",
                "mass": M + m,
                "damping": b,
                "hand": {"damping": 2.0, "stiffness": 150.0, "motion": "0.02*step(t - 0.1)"},
            }
        },
        "couplings": {"grip": {"devices": ["pen"]}},
        "environment": gel,
        "design": {"coupling": "spring-damper", "objective": "stiffest"},
    }
)
print(session)
print(mh.budget(session))

# %% [markdown]
# ## The coupling
#
# The budget says that nothing stiffer than 3240 N/m can be certified for this device at 1 kHz. The design goes there.

# %%
certificate = mh.certify(session)
print(f"K = {certificate.stiffness[0, 0]:.0f} N/m, B = {certificate.damping[0, 0]:.3f} N·s/m")
print(mh.verify(certificate, session))
assert mh.verify(certificate, session)

# %% [markdown]
# What does the hand feel? The coupling is in series with the gel, F(E, V) = E/(1 + E V). At rest it gives way by
# the compliances of both: 1/(1/500 + 1/3240), which is 433 N/m.

# %%
responses = certificate.frequency_responses([0.1, 100.0, 1000.0])
for omega, E, F in zip(responses.omega, responses.E[:, 0, 0], responses.F[:, 0, 0], strict=True):
    print(f"{omega:6g} rad/s: the gel {abs(E):4.0f} N/m, felt {abs(F):4.0f} N/m")
mh.plot(certificate, "impedance")
plt.savefig("own_plant_impedance.png")

# %% [markdown]
# ## A first touch
#
# The hand moves 20 mm into the gel. `simulate` runs the cores of the real processes; `mh.run` with the same session
# runs the processes themselves.

# %%
run = mh.simulate(session, 1.5, certificate=certificate)
print(f"pen at {1e3 * run.x[-1, 0]:.1f} mm, pushed back by {abs(run.f_v[-1, 0]):.2f} N")
figure, (above, below) = plt.subplots(2, 1, sharex=True, layout="constrained")
mh.plot(run, "sample", ax=above)
mh.plot(run, "force", ax=below)
figure.savefig("own_plant_touch.png")

# %% [markdown]
# ## Back to other tools
#
# `certificate.V` and `certificate.E` are (A, B, C, D, dt). SciPy takes them as they are, and python-control as
# `control.ss(*certificate.V)`.

# %%
_, response = scipy.signal.dstep(certificate.V, n=2000)
print(f"1 N pushes the coupling together by {1e3 * response[0][-1, 0]:.4f} mm in the end")
assert np.isclose(response[0][-1, 0] * certificate.stiffness[0, 0], 1.0)

# %% [markdown]
# Save the certificate, and run the session under it: `manyhands launch gel.yaml --certificate gel.cert.json`.

# %%
certificate.save("gel.cert.json")
