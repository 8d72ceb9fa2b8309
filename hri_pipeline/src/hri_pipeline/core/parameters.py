"""Parameters of a node: frozen dataclasses whose fields tell type, unit, range, default and effect, in one place.

    @dataclass(frozen=True)
    class FacesSettings(CameraSettings):
        max_faces: int = parameter(10, "Most faces at the same time.", minimum=1, maximum=64, live=True)

    FACES = ParameterTable("faces", FacesSettings)
    settings = FACES.resolve({"max_faces": 3})
"""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import json
import math
import re
import textwrap
from dataclasses import dataclass
from typing import Any, Dict, Generic, List, Mapping, Optional, Sequence, Tuple, Type, TypeVar, Union, cast

Number = Union[int, float]
_T = TypeVar("_T")
_FIELD = "parameter"
_SCALARS = {bool: "bool", int: "int", float: "float", str: "string"}


class ParameterError(ValueError):
    """A parameter whose name, type or value is not legal."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a node. Its type is that of `default`: bool, int, float, str, or a list of one of them.

    Attributes
    ----------
    name : str
    default : bool, int, float, str or list
        An empty list is a list of strings.
    doc : str
        Its effect, for users.
    unit : str
    minimum, maximum : int or float, optional
        Both are legal values; they hold for each item of a list.
    choices : tuple
        Legal values, of each item of a list; empty if there are others.
    live : bool
        It may be changed while the node runs. A list cannot be live, and a number needs minimum and maximum.
    shared : str
        Parameter of the whole stack that is used where the node's own is not set; the annotated file leaves the own one
        out.

    Raises
    ------
    ValueError
        When the entry contradicts itself.
    """

    name: str
    default: object
    doc: str
    unit: str = ""
    minimum: Optional[Number] = None
    maximum: Optional[Number] = None
    choices: Tuple = ()
    live: bool = False
    shared: str = ""

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise ValueError("parameter name {!r} is not an identifier".format(self.name))
        if not self.doc.strip():
            raise ValueError("parameter {} has no text".format(self.name))
        if isinstance(self.default, tuple):
            object.__setattr__(self, "default", list(self.default))
        if self.item_type not in _SCALARS:
            raise ValueError("parameter {}: a default of type {} is not supported".format(
                self.name, type(self.default).__name__))
        object.__setattr__(self, "choices", tuple(self.choices))
        try:
            self.check(self.default)
        except ParameterError as error:
            raise ValueError("the default is not legal: {}".format(error)) from error
        if self.live and (self.is_list or self.item_type in (int, float) and None in (self.minimum, self.maximum)):
            raise ValueError("parameter {} cannot change while the node runs: it is a list, or a number without "
                             "minimum and maximum".format(self.name))

    @property
    def is_list(self) -> bool:
        """Tell whether the parameter is a list."""
        return isinstance(self.default, list)

    @property
    def item_type(self) -> type:
        """Type of the value, or of each item of a list."""
        if not isinstance(self.default, list):
            return type(self.default)
        return type(self.default[0]) if self.default else str

    @property
    def type_name(self) -> str:
        """Type in words."""
        name = _SCALARS[self.item_type]
        return "list of " + name if self.is_list else name

    @property
    def annotation(self) -> str:
        """Type of the field in the dataclass."""
        name = self.item_type.__name__
        return "Sequence[{}]".format(name) if self.is_list else name

    @property
    def range_text(self) -> str:
        """Legal range in words, empty when there is none."""
        if self.choices:
            return "one of " + ", ".join(format_value(choice) for choice in self.choices)
        if self.minimum is not None and self.maximum is not None:
            return "{:g} to {:g}".format(self.minimum, self.maximum)
        if self.minimum is not None:
            return "{:g} and more".format(self.minimum)
        if self.maximum is not None:
            return "{:g} and less".format(self.maximum)
        return ""

    def check(self, value: object) -> object:
        """Return `value` in the type of the parameter; a frame (by the parameter's name) without the slash before it,
        which tf2 refuses. Raises ParameterError with the value and the legal range."""
        if not self.is_list:
            found = self._check_item(value)
            is_frame = self.name.endswith(("frame", "frame_id"))
            return found.lstrip("/") if is_frame and isinstance(found, str) else found
        if not isinstance(value, (list, tuple)):
            raise self._refused(value)
        return [self._check_item(item) for item in value]

    def _check_item(self, value: object) -> object:
        wanted = self.item_type
        if wanted is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if wanted is str and type(value) is int and str(value) in self.choices:
            value = str(value)      # YAML makes a number of 90
        # type() and not isinstance(): a bool is an int in Python, but not to whoever wrote the value.
        if type(value) is not wanted:
            raise self._refused(value)
        if self.choices and value not in self.choices:
            raise self._refused(value)
        if wanted in (int, float) and isinstance(value, (int, float)):
            if not math.isfinite(value):
                raise self._refused(value)
            if self.minimum is not None and value < self.minimum:
                raise self._refused(value)
            if self.maximum is not None and value > self.maximum:
                raise self._refused(value)
        return value

    def _refused(self, value: object) -> ParameterError:
        legal = self.type_name
        if self.range_text:
            legal += ", " + self.range_text
        if self.unit:
            legal += " " + self.unit
        return ParameterError("parameter {} is {!r} ({}); legal: {}; default: {}".format(
            self.name, value, type(value).__name__, legal, format_value(self.default)))


@dataclass(frozen=True)
class Settings:
    """Values of the parameters of a node, or of a group of them that several nodes have: base of their dataclasses.

    Each field is made by `parameter`. In files and pages the parameters of the bases come first, in the order in which
    the bases are named, then those of the class; one that is defined again stands where it is defined last.
    """


S = TypeVar("S", bound=Settings)


def parameter(default: _T, doc: str, unit: str = "", minimum: Optional[Number] = None,
              maximum: Optional[Number] = None, choices: Tuple = (), live: bool = False, shared: str = "") -> _T:
    """Return a field of a Settings dataclass. The arguments are the attributes of Parameter."""
    made = dict(default=default, doc=doc, unit=unit, minimum=minimum, maximum=maximum, choices=choices, live=live,
                shared=shared)
    if isinstance(default, (list, tuple)):
        items = list(default)
        return cast(_T, dataclasses.field(default_factory=lambda: list(items), metadata={_FIELD: made}))
    return cast(_T, dataclasses.field(default=default, metadata={_FIELD: made}))


def parameter_like(settings: Type[Settings], name: str, more: str = "", **changes: Any) -> Any:
    """Return the field `name` of another class with some attributes of Parameter changed.

    more: text that is added to the other's.
    """
    made = {one.name: one for one in dataclasses.fields(settings)}[name].metadata[_FIELD]
    return parameter(**{**made, "doc": made["doc"] + more, **changes})


def list_timeout_parameter() -> float:
    """Return the field `list_timeout`, which every node has that listens to a list of ids."""
    return parameter(
        0.0, "Silence after which a list of ids is empty. 0: never; a list then ends with its publisher, and "
        "one that is said once holds. The nodes of this stack repeat theirs once a second.", unit="s", minimum=0.0,
        maximum=3600.0)


def parameters_of(settings: Type[Settings]) -> Tuple[Parameter, ...]:
    """Return the parameters of a class of settings.

    Raises
    ------
    ValueError
        For a field that is not made by `parameter`, whose annotation is not the type of its default, or that two bases
        define in different ways.
    """
    fields = {one.name: one for one in dataclasses.fields(settings)}
    found: List[Parameter] = []
    for name in _names(settings):
        if name not in fields or _FIELD not in fields[name].metadata:
            raise ValueError("{}.{} is not a field made by parameter()".format(settings.__name__, name))
        made = Parameter(name, **fields[name].metadata[_FIELD])
        annotation = getattr(fields[name].type, "__name__", fields[name].type)
        if annotation != made.annotation:
            raise ValueError("{}.{} is annotated as {}, and its default is of type {}".format(
                settings.__name__, name, annotation, made.annotation))
        found.append(made)
    return tuple(found)


def _names(settings: Type[Settings]) -> List[str]:
    """Return the names of the parameters in their order."""
    own = list(settings.__dict__.get("__annotations__", ()))
    origin: Dict[str, object] = {}
    for base in settings.__bases__:
        if not issubclass(base, Settings):
            continue
        fields = {one.name: one for one in dataclasses.fields(base)}
        for name in _names(base):
            if name not in own and origin.pop(name, fields[name]) is not fields[name]:
                raise ValueError("parameter {} of {} is there twice, in different ways".format(name, settings.__name__))
            origin[name] = fields[name]
    return [name for name in origin if name not in own] + own


class ParameterTable(Generic[S]):
    """All parameters of a node.

    node: type of the node (`faces`), the name of its files config/<node>.yaml and docs/nodes/<node>.md.
    settings: dataclass of their values; the first paragraph of its docstring says what the node does.
    includes: tables of other nodes; the page of this node leaves out what stands on theirs.
    """

    def __init__(self, node: str, settings: Type[S], includes: Sequence[ParameterTable] = ()) -> None:
        self.node = node
        self.settings = settings
        self.summary = " ".join(inspect.cleandoc(settings.__doc__ or "").split("\n\n")[0].split())
        self.parameters: Tuple[Parameter, ...] = parameters_of(settings)
        self.includes: Tuple[ParameterTable, ...] = tuple(includes)

    def resolve(self, given: Mapping[str, object]) -> S:
        """Return the values of all parameters: those of `given`, checked, and the defaults of the others.

        Raises ParameterError that names parameter, value and legal range, or the known names for an unknown one.
        """
        return self.settings(**self._checked(given))

    @property
    def live(self) -> Tuple[Parameter, ...]:
        """Parameters that may be changed while the node runs."""
        return tuple(parameter for parameter in self.parameters if parameter.live)

    def changed(self, settings: S, changes: Mapping[str, object]) -> S:
        """Return `settings` with some values changed, checked.

        Raises ParameterError for a name that is not there, one that cannot change while the node runs, and a value that
        is not legal.
        """
        live = {parameter.name for parameter in self.live}
        fixed = sorted(one.name for one in self.parameters if one.name in changes and not one.live)
        if fixed:
            raise ParameterError("{} of {} cannot change while the node runs; these can: {}".format(
                ", ".join(fixed), self.node, ", ".join(sorted(live)) or "none"))
        return dataclasses.replace(settings, **self._checked(changes))

    def _checked(self, given: Mapping[str, object]) -> Dict[str, Any]:
        """Return the values in the types of their parameters. Raises ParameterError."""
        known = {parameter.name: parameter for parameter in self.parameters}
        for name in sorted(given):
            if name not in known:
                near = difflib.get_close_matches(name, known, n=1)
                hint = " (did you mean {}?)".format(near[0]) if near else ""
                raise ParameterError("{} has no parameter {}{}; known: {}".format(
                    self.node, name, hint, ", ".join(sorted(known))))
        return {name: known[name].check(value) for name, value in given.items()}

    def to_yaml(self) -> str:
        """Return an annotated YAML file that holds the defaults."""
        lines = ["# " + line for line in textwrap.wrap(self.summary, 96)]
        lines += ["# Written by `rosrun hri_pipeline parameter_docs` from the table of the node."]
        for parameter in self.parameters:
            facts = [parameter.type_name]
            facts += [parameter.range_text] if parameter.range_text else []
            facts += ["unit " + parameter.unit] if parameter.unit else []
            facts += ["default " + format_value(parameter.default)]
            facts += ["may change while the node runs"] if parameter.live else []
            facts += ["where it is not set here, {} counts".format(parameter.shared)] if parameter.shared else []
            lines += [""]
            lines += ["# " + line for line in textwrap.wrap(parameter.doc, 96)]
            lines += ["# " + line for line in textwrap.wrap("; ".join(facts), 96, break_long_words=False)]
            lines += ["{}{}: {}".format("# " if parameter.shared else "", parameter.name,
                                        format_value(parameter.default))]
        return "\n".join(lines) + "\n"

    def to_markdown(self, more: str = "") -> str:
        """Return a Markdown list, one line for each parameter: name, default with unit, legal range, meaning.

        A line holds the first statement of the text and what special values mean; the YAML file holds all of it.
        Parameters that are the same in all of `includes` that have them are left out.

        Parameters
        ----------
        more : str
            Link to the YAML file; empty: no link.
        """
        lines = ["Details: [{}]({}).".format(more.rsplit("/", 1)[-1], more)] if more else []
        lines += ["\\* can change [at run time](../tuning.md)."] if self.live else []
        lines = [" ".join(lines), ""] if lines else []
        lines += ["- `~{}`{} ({}): {}".format(parameter.name, "\\*" if parameter.live else "",
                                              _default_and_range(parameter), _meaning(parameter))
                  for parameter in self.parameters if not self._is_included(parameter)]
        return "\n".join(lines) + "\n"

    def _is_included(self, parameter: Parameter) -> bool:
        """Tell whether all tables of `includes` that have a parameter of this name have the same one."""
        same = [other == parameter for table in self.includes for other in table.parameters
                if other.name == parameter.name]
        return bool(same) and all(same)


def _default_and_range(parameter: Parameter) -> str:
    """Write default, unit and legal range in few words; of choices the default comes first."""
    text = "`{}`".format(format_value(parameter.default))
    if parameter.choices:
        others = [choice for choice in parameter.choices if parameter.is_list or choice != parameter.default]
        return text + (" of " if parameter.is_list else ", ") + ", ".join("`{}`".format(format_value(choice))
                                                                          for choice in others)
    text += " " + parameter.unit if parameter.unit else ""
    if parameter.minimum is not None and parameter.maximum is not None:
        return "{}, {:g}–{:g}".format(text, parameter.minimum, parameter.maximum)
    if parameter.minimum is not None:
        return "{}, ≥{:g}".format(text, parameter.minimum)
    return text if parameter.maximum is None else "{}, ≤{:g}".format(text, parameter.maximum)


def _meaning(parameter: Parameter) -> str:
    """Return the first statement of the text, and those statements that tell what a special value means."""
    choices = [re.escape(str(choice)) for choice in parameter.choices if choice]
    value = "|".join([r"-?\d[\d.]*", "[Ee]mpty", "[Tt]rue", "[Ff]alse", "[Oo]ff", "pi"] + choices)
    of_a_value = re.compile("`?(?:{})`?:{}".format(value, "".join("|`{}` ".format(choice) for choice in choices)))
    # A statement ends with a full stop or a semicolon outside of brackets; the first one also with a colon, unless
    # that follows only some words ("Type of `roi`: ...").
    first, *others = re.split(r"(?<=\.)\s+(?=[A-Z0-9`\"]|(?:{}):)|;\s+(?![^(]*\))".format(value),
                              " ".join(parameter.doc.split()))
    if not of_a_value.match(first):
        first = re.sub(r"^((?:\S+ ){4,}?\S+):\s(?![^(]*\)).*", r"\1", first)
    kept = [text.rstrip(".") for text in [first] + [text for text in others if of_a_value.match(text)]]
    if parameter.shared:
        kept.append("Unset: `{}`".format(parameter.shared))
    return ". ".join(kept) + "."


def format_value(value: object) -> str:
    """Write a value in YAML."""
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(format_value(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        text = repr(value)
        # YAML 1.1 reads 1e-05 as a string: it wants a point.
        return text.replace("e", ".0e") if "e" in text and "." not in text else text
    return json.dumps(value, ensure_ascii=False)
