"""ROS 1's rospy: a topic for each direction of a link, without Nagle's delay; callbacks put frames into queues."""

import os
import queue
import threading

import rospkg
import rospy
from chain import Peer
from std_msgs.msg import UInt8MultiArray


class RospyWire:
    """A :class:`chain.Wire`."""

    def __init__(self, node: str, peers: list[Peer]) -> None:
        self.version = f"rospy {rospkg.RosPack().get_manifest('rospy').version}"
        rospy.init_node(node, disable_signals=True)
        self._out, self._heard = {}, {}
        matched = []
        for peer in peers:
            heard: queue.SimpleQueue[bytes] = queue.SimpleQueue()
            self._heard[peer.name] = heard
            rospy.Subscriber(
                f"/{peer.name}_{node}", UInt8MultiArray, lambda m, heard=heard: heard.put(m.data), tcp_nodelay=True
            )
            matched.append(threading.Event())
            self._out[peer.name] = rospy.Publisher(
                f"/{node}_{peer.name}", UInt8MultiArray, _Told(matched[-1]), tcp_nodelay=True, queue_size=None
            )
        for one in matched:
            one.wait()

    def send(self, peer: str, frame: bytes) -> None:
        """See :class:`chain.Wire`."""
        self._out[peer].publish(UInt8MultiArray(data=frame))

    def receive(self, peer: str, wait: float) -> bytes | None:
        """See :class:`chain.Wire`."""
        try:
            return self._heard[peer].get(timeout=wait)
        except queue.Empty:
            return None


class _Told(rospy.SubscribeListener):  # type: ignore[misc]
    """Sets an event at the first subscription."""

    def __init__(self, event: threading.Event) -> None:
        super().__init__()
        self._event = event

    def peer_subscribe(self, *_: object) -> None:
        self._event.set()


def open_wire(node: str, peers: list[Peer], folder: str, port: int) -> RospyWire:
    """Open, and wait until every peer has subscribed at the master of this run."""
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}/"
    os.environ["ROS_IP"] = "127.0.0.1"
    os.environ["ROS_LOG_DIR"] = folder
    return RospyWire(node, peers)
