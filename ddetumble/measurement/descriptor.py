"""The descriptor `datapackage.json`: its schema, and reading it with the place of every mistake."""

import json
import math
import re
from collections import Counter
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StrictBool, StrictFloat, StrictInt, StrictStr, ValidationError

from .._errors import InputError, error_place
from .._settings import locate_campaign
from .kinds import KINDS
from .tables import decode


Name = Annotated[StrictStr, Field(min_length=1, max_length=200)]
Number = StrictStr | StrictInt | StrictFloat | None  # with its unit, where it is text


class _Open(BaseModel):
    """Further keys are allowed, as the Data Package standard wants it."""

    model_config = ConfigDict(extra="allow", frozen=True)


class FieldModel(_Open):
    """One column of a table: the Table Schema's field with units, uncertainties, `reference` and `assumed`, and
    what the imported file stated."""

    name: Name
    type: StrictStr | None = None
    unit: StrictStr | None = None
    stated_unit: StrictStr = ""
    stated_reference: Literal["gauge", "absolute"] | None = None
    uncertainty: Number = None
    common_uncertainty: Number = None
    reference: Literal["gauge", "absolute"] | None = None
    assumed: StrictBool = False
    description: StrictStr = ""
    decimalChar: Literal[".", ","] = "."
    groupChar: None = None
    bareNumber: Literal[True] = True

    @property
    def numeric(self) -> bool:
        """Whether the column holds numbers: so declared, or undeclared but with a unit."""
        return self.type in ("number", "integer") or (self.type is None and self.unit is not None)


class SchemaModel(_Open):
    """Columns and keys of a table."""

    fields: Annotated[list[FieldModel], Field(min_length=1)]
    primaryKey: StrictStr | list[StrictStr] | None = None
    foreignKeys: list[dict] = []
    missingValues: list[StrictStr] = [""]


class DialectModel(_Open):
    """How the CSV is written."""

    delimiter: Annotated[StrictStr, Field(min_length=1, max_length=1, pattern=r"[^\r\n\"]")] = ","
    quoteChar: Annotated[StrictStr, Field(min_length=1, max_length=1, pattern=r"[^\r\n]")] = '"'
    header: Literal[True] = True
    doubleQuote: Literal[True] = True
    escapeChar: None = None
    commentChar: None = None


class ResourceModel(_Open):
    """One table."""

    name: Name
    path: StrictStr | Annotated[list[StrictStr], Field(min_length=1, max_length=1)]
    format: Literal["csv", "CSV", "tsv"] | None = None
    encoding: StrictStr = "utf-8"
    compression: None = None
    dialect: DialectModel = DialectModel()
    table: SchemaModel = Field(alias="schema")


class DescriptorModel(_Open):
    """The whole descriptor."""

    name: Annotated[StrictStr, Field(max_length=200)] = ""
    title: StrictStr = ""
    family: StrictStr
    known: dict[Name, Number] = {}
    resources: Annotated[list[ResourceModel], Field(min_length=1)]
    sources: list[dict] = []
    licenses: list[dict] = []


def find_descriptor(path) -> Path:
    """The descriptor of a campaign given as its folder, as the descriptor itself, or by the name of a shipped one."""
    with error_place(file=path):
        try:
            path = locate_campaign(path)
            if path.is_dir():
                if not (path / "datapackage.json").exists():
                    if (path / "model.json").is_file():
                        raise InputError("this folder holds a fitted model and no campaign: name the campaign of its "
                                         "tests, and the model by -m")
                    raise InputError("there is no datapackage.json in this folder, so it is no campaign; `ddetumble "
                                     "import` makes one of the files of a test bench")
                return path / "datapackage.json"
            if not path.exists():
                raise InputError("there is no such campaign folder; check the path")
            if path.suffix != ".json":
                raise InputError("this is a file; a campaign is a folder with a datapackage.json")
            return path
        except InputError:
            raise
        except (OSError, ValueError):
            raise InputError("this is not a usable path") from None


def parse_descriptor(data: bytes, file: str) -> DescriptorModel:
    """Bytes of a descriptor to its checked model; what is not JSON is refused by line, what breaks the schema by key.
    """
    text = decode(data, file)
    with error_place(file=file):
        if not text.strip():
            raise InputError("the file is empty; it needs the campaign's descriptor")
        try:
            tree = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_refuse_repeated)
            if isinstance(tree, dict):
                return DescriptorModel.model_validate(tree)
        except json.JSONDecodeError as error:
            cut = "; the file seems to be cut off" if error.pos >= len(text.rstrip()) - 1 else ""
            problem = f"this is not valid JSON at character {error.colno} of the line: {error.msg}{cut}"
            raise InputError(problem, row=error.lineno) from None
        except ValidationError as error:
            raise InputError(_explain(error, tree)) from None
        except RecursionError:
            raise InputError("this is nested too deeply to be a descriptor") from None
        except ValueError as error:
            raise InputError(f"this is not a valid descriptor: {error}") from None
        raise InputError("the descriptor must be a JSON object with family, known and resources")


def locate_resource(resource: ResourceModel, descriptor: Path) -> Path:
    """Path of a resource's table, which must lie inside the campaign's folder, also where it is a link."""
    name = resource.path if isinstance(resource.path, str) else resource.path[0]
    place, folder = PurePosixPath(name), descriptor.parent
    with error_place(f"the path {name!r} of resource {resource.name} ", file=descriptor):
        if not name or not name.isprintable() or "\\" in name or re.match(r"[A-Za-z][\w+.-]*:", name):
            raise InputError("is not a plain relative path with forward slashes")
        if place.is_absolute() or ".." in place.parts:
            raise InputError("leaves the campaign's folder; put the table inside")
        try:
            inside = (folder / name).resolve().is_relative_to(folder.resolve())
        except (OSError, RuntimeError) as error:
            raise InputError("cannot be used") from error
        if not inside:
            raise InputError("is a link out of the folder; put the table inside")
    return folder / name


def _refuse_constant(word: str):
    raise ValueError(f"{word} is not a number in JSON; write null or a finite number")


def _refuse_repeated(pairs: list) -> dict:
    again = [name for name, count in Counter(name for name, _ in pairs).items() if count > 1]
    if again:
        raise ValueError(f"the key {again[0]!r} occurs twice in one object; keep one")
    return dict(pairs)


def _explain(error: ValidationError, tree: dict) -> str:
    """The first mistake that pydantic found, as a sentence with the place in the descriptor."""
    first = error.errors(include_url=False, include_input=True, include_context=False)[0]
    given = first["input"]
    place, here = "", tree
    for part in first["loc"]:
        try:
            here = None if here is None else here[part]
        except (KeyError, IndexError, TypeError):
            here = None
        if isinstance(part, int):
            name = here.get("name") if isinstance(here, dict) else None
            place += f"[{part + 1}]" + (f" ({name})" if isinstance(name, str) else "")
        elif not re.search(r"[\[(]", part) and part not in ("str", "int", "float"):
            place += f"{'.' if place else ''}{part}"
    if first["type"] == "missing":
        more = f": {', '.join(KINDS)} or FILE.py:NAME for one of your own" if place == "family" else ""
        return f"{place} is missing; add it{more}"
    if isinstance(given, float) and not math.isfinite(given):
        given = "not finite"
    shown = repr(given) if isinstance(given, str | int | float | bool | None) else f"of type {type(given).__name__}"
    message = first["msg"][:1].lower() + first["msg"][1:]
    return f"{place} does not fit the campaign's schema: {message}; it is {shown[:80]}"
