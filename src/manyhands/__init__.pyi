from manyhands.design import passivity as passivity
from manyhands.design.certificate import Certificate as Certificate
from manyhands.design.errors import DesignError as DesignError
from manyhands.design.errors import Infeasible as Infeasible
from manyhands.design.models.statespace import LinearSystem as LinearSystem
from manyhands.launch.app.api import budget as budget
from manyhands.launch.app.api import certify as certify
from manyhands.launch.app.api import load as load
from manyhands.launch.app.api import plot as plot
from manyhands.launch.app.api import read as read
from manyhands.launch.app.api import run as run
from manyhands.launch.app.api import simulate as simulate
from manyhands.launch.app.api import verify as verify
from manyhands.launch.app.background import RunFailed as RunFailed
from manyhands.launch.app.sweep import sweep as sweep
from manyhands.launch.audit.simulation import Silence as Silence
from manyhands.launch.plan.loop import NotCertified as NotCertified
from manyhands.launch.session import Session as Session
from manyhands.launch.session import SessionError as SessionError
from manyhands.nodes.kernel.orientation import OrientationBank as OrientationBank
from manyhands.nodes.kernel.orientation import OrientationSpring as OrientationSpring
from manyhands.nodes.kernel.orientation import Quaternion as Quaternion

__version__: str
