"""A message as data, and the English text of every code."""

from bus.messages.message import LIST as LIST
from bus.messages.message import NUMBER as NUMBER
from bus.messages.message import PARAMETER as PARAMETER
from bus.messages.message import TERM as TERM
from bus.messages.message import Message as Message
from bus.messages.message import ParamValue as ParamValue
from bus.messages.message import in_english as in_english
from bus.messages.message import joined as joined
from bus.messages.message import listed as listed
from bus.messages.message import number as number
from bus.messages.message import parameter_name as parameter_name
from bus.messages.message import shown as shown
from bus.messages.message import term as term
from bus.messages.texts import ENGLISH as ENGLISH
from bus.messages.texts import PARAMETER_NAMES as PARAMETER_NAMES
from bus.messages.texts import TEXTS as TEXTS
from bus.messages.texts import Catalog as Catalog
from bus.messages.texts import Plural as Plural
