"""ROS 1's master for one run, on the port that the command line names; prints a line once it serves."""

import ctypes
import signal
import sys
import threading

from rosmaster.master import Master

if __name__ == "__main__":
    ctypes.CDLL(None).prctl(1, signal.SIGKILL, 0, 0, 0)  # PR_SET_PDEATHSIG: no longer than the benchmark
    master = Master(int(sys.argv[1]))
    master.start()
    print("up", flush=True)
    threading.Event().wait()  # until killed
