"""Changing parameters of a node while it runs, with the topics and the service of dynamic_reconfigure."""

from __future__ import annotations

import threading
from typing import Callable, Dict, Generic, Iterable, Mapping, NoReturn, Protocol, TypeVar

import rospy
from dynamic_reconfigure.msg import (
    BoolParameter,
    Config,
    ConfigDescription,
    DoubleParameter,
    Group,
    GroupState,
    IntParameter,
    ParamDescription,
    StrParameter,
)
from dynamic_reconfigure.srv import Reconfigure, ReconfigureRequest, ReconfigureResponse

from hri_pipeline.core.parameters import Parameter, ParameterError, ParameterTable, S, Settings, format_value
from hri_pipeline.ros.master import OwnParameters
from hri_pipeline.ros.node import RunnableNode, read_parameters, run_node
from hri_pipeline.ros.rospy_compat import release

_New = TypeVar("_New", bound=Settings, contravariant=True)
_TYPES = {bool: "bool", int: "int", float: "double", str: "str"}
_ALL = "Default"


class LiveNode(RunnableNode, Protocol[_New]):
    """A node some of whose parameters may be changed while it runs."""

    def reconfigure(self, settings: _New) -> None:
        """Apply the values of all parameters, between two images or cycles, from any thread.

        Raises ValueError when they contradict each other; then nothing has changed.
        """


def run_live_node(name: str, table: ParameterTable[S], build: Callable[[S], LiveNode[S]]) -> NoReturn:
    """Run the node that build(settings) makes, as run_node does, and let its live parameters be changed."""
    parameters = OwnParameters()

    def make() -> _Live:
        settings = read_parameters(table)
        return _Live(build(settings), table, settings, parameters)

    run_node(name, make, parameters)


class _Live:
    """A node with its reconfiguration."""

    def __init__(self, node: LiveNode[S], table: ParameterTable[S], settings: S, parameters: OwnParameters) -> None:
        self._node = node
        try:
            self._reconfiguration = Reconfiguration(table, settings, node.reconfigure, parameters)
        except BaseException:
            node.close()
            raise

    def spin(self) -> None:
        self._node.spin()

    def close(self) -> None:
        self._reconfiguration.close()
        self._node.close()


class Reconfiguration(Generic[S]):
    """Serves `~set_parameters`, and latches `~parameter_descriptions` and `~parameter_updates`.

    table: of the node; only its live parameters can be changed. settings: their values now. apply: called with all
    values after a change, in a thread of rospy; ValueError means that they contradict each other. parameters: of the
    node, in which what is changed is kept.

    A value outside its range is an error of the service that says what is legal. One that contradicts others is told in
    the log, and the answer says what is in force: a slider does not know of the others. Nothing is changed by halves.
    What is in force stands in the private namespace of the parameter server, too: a node that is started again goes on
    with it.
    """

    def __init__(self, table: ParameterTable[S], settings: S, apply: Callable[[S], None],
                 parameters: OwnParameters) -> None:
        self._parameters = parameters
        self._table = table
        self._settings = settings
        self._apply = apply
        self._lock = threading.Lock()
        self._closed = False
        self._descriptions = rospy.Publisher("~parameter_descriptions", ConfigDescription, queue_size=1, latch=True)
        self._updates = rospy.Publisher("~parameter_updates", Config, queue_size=1, latch=True)
        self._descriptions.publish(describe(table))
        self._updates.publish(config_of(table.live, vars(self._settings)))
        self._service = rospy.Service("~set_parameters", Reconfigure, self._on_request)

    def close(self) -> None:
        """Take service and topics back. Idempotent."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        self._service.shutdown("closing")
        release(self._descriptions)
        release(self._updates)

    def _on_request(self, request: ReconfigureRequest) -> ReconfigureResponse:
        with self._lock:
            if self._closed:
                raise rospy.ServiceException("{} is closing".format(rospy.get_name()))
            try:
                wanted = self._table.changed(self._settings, values_of(request.config))
            except ParameterError as error:
                rospy.logwarn("nothing is changed: %s", error)
                raise rospy.ServiceException(str(error)) from error
            self._change(wanted)
            config = config_of(self._table.live, vars(self._settings))
            self._updates.publish(config)
            return ReconfigureResponse(config)

    def _change(self, wanted: S) -> None:
        before = vars(self._settings)
        changed = {name: value for name, value in vars(wanted).items() if value != before[name]}
        if not changed:
            return
        try:
            self._apply(wanted)
        except ValueError as error:
            rospy.logwarn("nothing is changed: %s", error)
            return
        self._settings = wanted
        for name, value in changed.items():
            rospy.loginfo("%s is now %s (was %s)", name, format_value(value), format_value(before[name]))
            self._keep(name, value)

    def _keep(self, name: str, value: object) -> None:
        """Put a value on the parameter server, as the node's own: that counts before the one of the whole stack."""
        try:
            self._parameters.set(name, value)
        except Exception as error:  # the master is away; the value counts all the same
            rospy.logwarn("%s could not be put on the parameter server: %s", name, error)


def describe(table: ParameterTable) -> ConfigDescription:
    """Return the description of the live parameters of a table."""
    values = {parameter.name: parameter.default for parameter in table.live}
    lowest = {parameter.name: _end(parameter, parameter.minimum, False) for parameter in table.live}
    highest = {parameter.name: _end(parameter, parameter.maximum, True) for parameter in table.live}
    rows = [ParamDescription(parameter.name, _TYPES[parameter.item_type], 0, _text(parameter), _choices(parameter))
            for parameter in table.live]
    return ConfigDescription(
        groups=[Group(name=_ALL, type="", parameters=rows, parent=0, id=0)], max=config_of(table.live, highest),
        min=config_of(table.live, lowest), dflt=config_of(table.live, values))


def config_of(parameters: Iterable[Parameter], values: Mapping[str, object]) -> Config:
    """Return the message with the values of these parameters."""
    config = Config(groups=[GroupState(_ALL, True, 0, 0)])
    lists = {bool: (config.bools, BoolParameter), int: (config.ints, IntParameter),
             float: (config.doubles, DoubleParameter),
             str: (config.strs, StrParameter)}
    for parameter in parameters:
        found, kind = lists[parameter.item_type]
        found.append(kind(parameter.name, values[parameter.name]))
    return config


def values_of(config: Config) -> Dict[str, object]:
    """Return the values of a message by name."""
    return {item.name: item.value for items in (config.bools, config.ints, config.strs, config.doubles)
            for item in items}


def _end(parameter: Parameter, value: object, highest: bool) -> object:
    """Return an end of the range; bool and str have none, and what the tools put there instead."""
    if parameter.item_type is bool:
        return highest
    return "" if parameter.item_type is str else parameter.item_type(value)


def _text(parameter: Parameter) -> str:
    unit = " ({})".format(parameter.unit) if parameter.unit else ""
    return " ".join(parameter.doc.split()) + unit


def _choices(parameter: Parameter) -> str:
    """Return the legal values as the tools read them: a dictionary in the syntax of Python, empty without choices."""
    if not parameter.choices:
        return ""
    kind = _TYPES[parameter.item_type]
    return repr({"enum": [{"name": str(choice), "type": kind, "value": choice, "description": ""}
                          for choice in parameter.choices], "enum_description": parameter.name})
