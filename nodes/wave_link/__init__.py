"""The wave link: a passive two-port between a coupling and the environment, over any delay and any loss.

It stands at the port (w(k), f(k)) with w = (x(k) - x(k-1))/T, of m ports. The *user's face* is in the coupling's
process and plays the environment. The *world's face* is in the environment's process and plays a coupling. They
exchange :class:`Sums` messages; each face has its own tick and its own period T.

| letter | is | shape, unit |
|---|---|---|
| b | wave impedance of the link, b = b^T > 0, the same at both faces | m x m, N*s/m |
| h | (2b)^(1/2), symmetric | m x m, (N*s/m)^(1/2) |
| c, a | the incoming and the outgoing wave of a tick | m, W^(1/2) |
| L | energy in a face's tank | J |
| U | sum of T a over the ticks in which a face plays | m, W^(1/2)*s |
| G | energy that a face has shipped in this life; it never falls | J |
| theta | level that the certificate leaves to the face, theta = theta^T >= 0 | m x m, N*s/m |
| E_0 | L at the start, of each face | J |

At the user's face and at the world's face, in every tick,

    h c = b w_c + f_c,   h a = b w_c - f_c,        h c = b w_e - f_e,   h a = b w_e + f_e,

so that T/2 (|a|^2 - |c|^2) is the energy that enters the link there, -T f_c^T w_c and T f_e^T w_e. Whatever is
delivered, and whenever, the energy that entered the link at both ports is never below -2 E_0, apart from the harvest
sum of T w^T theta w (docs/remote/proof.md has the theorems). :mod:`~manyhands.nodes.wave_link.tank` keeps
the account that this rests on; :mod:`~manyhands.nodes.wave_link.play_out` decides when a wave is played, and no proof
depends on it. :mod:`~manyhands.nodes.wave_link.faces` joins the two.
"""

from manyhands.nodes.wave_link.faces import Sums, UserFace, WorldFace

__all__ = ["Sums", "UserFace", "WorldFace"]
