"""Many hands, one virtual world, and a proof that it is stable: ``import manyhands as mh``.

| name | does |
|---|---|
| ``mh.load``, ``mh.Session`` | a session, from a file, the name of a shipped one, or Python data |
| ``mh.certify``, ``mh.verify``, ``mh.budget`` | a coupling with its certificate; its proof; what could be certified |
| ``mh.simulate``, ``mh.run`` | a run in this process; a run of real processes, for as long as a ``with`` block |
| ``mh.sweep`` | a task for many sessions, on any executor |
| ``mh.read``, ``mh.plot`` | a recording; pictures of runs, designs and budgets |
| ``mh.passivity`` | the lemmas and theorems behind it, for any linear system |
| ``mh.OrientationSpring``, ``mh.OrientationBank``, ``mh.Quaternion`` | a spring between orientations |
| ``mh.Certificate``, ``mh.LinearSystem``, ``mh.Silence`` | what these take and return |
| ``mh.SessionError``, ``mh.DesignError``, ``mh.Infeasible``, ``mh.NotCertified``, ``mh.RunFailed`` | what they raise |

docs/python.md introduces them. Each is imported at its first use, so that importing this package takes no time.

Four rooms hold the code, imported one way (``design | protocol`` <- ``nodes`` <- ``launch``):

* :mod:`manyhands.design`: models, passivity, LMIs, couplings, certificates;
* :mod:`manyhands.protocol`: what crosses a process border;
* :mod:`manyhands.nodes`: the device, coupling and environment processes;
* :mod:`manyhands.launch`: session files, the supervisor, the command line.

Example:
    >>> import manyhands as mh
    >>> session = mh.load("example1")
    >>> certificate = mh.certify(session)
    >>> bool(mh.verify(certificate, session))
    True
    >>> run = mh.simulate(session, 1.0, certificate=certificate)
    >>> print(f"{certificate.stiffness[0, 0]:.0f} N/m; fastest hand {abs(run.velocity).max():.2f} m/s")
    1110 N/m; fastest hand 0.14 m/s
"""

from manyhands.lazy_names import lazy_names

__version__ = "0.7.0.dev0"

__getattr__, __dir__ = lazy_names(__name__, __file__)
