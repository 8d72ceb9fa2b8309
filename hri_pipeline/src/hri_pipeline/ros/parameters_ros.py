"""Reads the parameters of a node from its private namespace."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Mapping, Optional

import rospy

from hri_pipeline.core.parameters import ParameterError, ParameterTable


def read_parameters(table: ParameterTable, shared: Optional[Mapping[str, str]] = None) -> SimpleNamespace:
    """Return the parameters of `table` out of the private namespace, as attributes.

    shared: {name: parameter of the whole stack that goes before it where it is set}.
    Raises ParameterError that names the parameter, its value and what is legal.
    """
    namespace = rospy.get_name()
    given = rospy.get_param(namespace, {})
    if not isinstance(given, dict):
        raise ParameterError("{} is a value on the parameter server, not a set of parameters".format(namespace))
    given = dict(given, **{name: rospy.get_param(path) for name, path in (shared or {}).items() if rospy.has_param(path)})
    try:
        return table.resolve(given)
    except ParameterError as error:
        raise ParameterError("{}: {}".format(namespace, error)) from error
