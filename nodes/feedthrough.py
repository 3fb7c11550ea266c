"""By what the environment knows the D_V that its certificate is about, without being given it.

The launcher puts the digest of every block's D_V into the environment's bundle; a coupling says its D_V at the
handshake. One that runs another block than the certificate's is found out as far as the environment can see.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import ArrayLike


def feedthrough_digest(D_V: ArrayLike) -> str:
    """SHA-256 of D_V (m/N) as little-endian float64, row by row; 64 hexadecimal digits."""
    return hashlib.sha256(np.ascontiguousarray(D_V, dtype="<f8").tobytes()).hexdigest()
