"""The messages between a bus worker and the app, the only thing that the two share.

The worker opens the WebSocket and sends first. The order is fixed: ``Hello`` → (app) ``Welcome`` →
``Snapshot`` → the backlog that the app does not have, as ``Batch`` with ``live=False`` → ``Batch`` after
``Batch``, numbered without a gap. The app confirms each with ``Delivered`` so that the worker may delete it.

Times are seconds since the epoch on the sender's clock (float, microsecond resolution). Speeds, parameters
and analog values are the raw integers of the wire.
"""

from bus.contract.actions import BUFFER_AGE_S as BUFFER_AGE_S
from bus.contract.actions import CONTRACT_VERSION as CONTRACT_VERSION
from bus.contract.actions import MAX_FRAME as MAX_FRAME
from bus.contract.actions import MAX_MEANING as MAX_MEANING
from bus.contract.actions import MAX_MEANINGS as MAX_MEANINGS
from bus.contract.actions import MAX_UPDATES as MAX_UPDATES
from bus.contract.actions import Action as Action
from bus.contract.actions import BusLinkState as BusLinkState
from bus.contract.actions import ChangeBaud as ChangeBaud
from bus.contract.actions import Direction as Direction
from bus.contract.actions import ExecuteAll as ExecuteAll
from bus.contract.actions import ExecuteSpeed as ExecuteSpeed
from bus.contract.actions import Outcome as Outcome
from bus.contract.actions import ReadParameters as ReadParameters
from bus.contract.actions import ReadTrace as ReadTrace
from bus.contract.actions import ScanBus as ScanBus
from bus.contract.actions import SetLine as SetLine
from bus.contract.actions import SetSpeed as SetSpeed
from bus.contract.actions import Stage as Stage
from bus.contract.actions import TaggedStruct as TaggedStruct
from bus.contract.actions import UnitAction as UnitAction
from bus.contract.actions import UnitLinkState as UnitLinkState
from bus.contract.actions import UnitScale as UnitScale
from bus.contract.actions import WireAction as WireAction
from bus.contract.actions import WriteAnalogOutput as WriteAnalogOutput
from bus.contract.actions import WriteOutput as WriteOutput
from bus.contract.actions import WriteParameter as WriteParameter
from bus.contract.session import AppMessage as AppMessage
from bus.contract.session import Batch as Batch
from bus.contract.session import Cancel as Cancel
from bus.contract.session import ClockSync as ClockSync
from bus.contract.session import Command as Command
from bus.contract.session import Delivered as Delivered
from bus.contract.session import Hello as Hello
from bus.contract.session import MalformedMessageError as MalformedMessageError
from bus.contract.session import ReserveTurn as ReserveTurn
from bus.contract.session import Snapshot as Snapshot
from bus.contract.session import WantSnapshot as WantSnapshot
from bus.contract.session import Watch as Watch
from bus.contract.session import Welcome as Welcome
from bus.contract.session import WorkerMessage as WorkerMessage
from bus.contract.session import decode_from_app as decode_from_app
from bus.contract.session import decode_from_worker as decode_from_worker
from bus.contract.session import encode as encode
from bus.contract.updates import FEW as FEW
from bus.contract.updates import TROUBLED as TROUBLED
from bus.contract.updates import BusFigures as BusFigures
from bus.contract.updates import BusLink as BusLink
from bus.contract.updates import FoundUnit as FoundUnit
from bus.contract.updates import Frame as Frame
from bus.contract.updates import Frames as Frames
from bus.contract.updates import ParameterValue as ParameterValue
from bus.contract.updates import Progress as Progress
from bus.contract.updates import Reading as Reading
from bus.contract.updates import Result as Result
from bus.contract.updates import Staged as Staged
from bus.contract.updates import UnitCounts as UnitCounts
from bus.contract.updates import UnitFigures as UnitFigures
from bus.contract.updates import UnitLink as UnitLink
from bus.contract.updates import UnitOutcome as UnitOutcome
from bus.contract.updates import UnitState as UnitState
from bus.contract.updates import Update as Update
