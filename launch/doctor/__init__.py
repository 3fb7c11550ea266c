"""`manyhands doctor`: what this machine permits, how fast a tick is on it, and what that allows to certify."""
