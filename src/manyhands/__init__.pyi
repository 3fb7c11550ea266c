from manyhands.design import passivity as passivity
from manyhands.design.certificate import Certificate as Certificate
from manyhands.design.errors import DesignError as DesignError
from manyhands.design.errors import Infeasible as Infeasible
from manyhands.design.models.statespace import LinearSystem as LinearSystem
from manyhands.launch.api import budget as budget
from manyhands.launch.api import design as design
from manyhands.launch.api import launch as launch
from manyhands.launch.api import load as load
from manyhands.launch.api import plot as plot
from manyhands.launch.api import read as read
from manyhands.launch.api import simulate as simulate
from manyhands.launch.api import verify as verify
from manyhands.launch.plan.prepare import NotCertified as NotCertified
from manyhands.launch.run.background import RunFailed as RunFailed
from manyhands.launch.session import Session as Session
from manyhands.launch.session import SessionError as SessionError
from manyhands.launch.simulation import Silence as Silence
from manyhands.launch.sweep import sweep as sweep

__version__: str
