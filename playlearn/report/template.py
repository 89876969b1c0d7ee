"""Templates of the pages, and the filters that write numbers and pictures into them."""

import base64
import functools
from importlib import resources

import jinja2

from playlearn.privileges import Privileges


def template(name: str) -> jinja2.Template:
    """A template of this folder; values are escaped in HTML."""
    return _environment().get_template(name)


@functools.cache
def _environment() -> jinja2.Environment:
    files = resources.files("playlearn.report")
    environment = jinja2.Environment(
        autoescape=jinja2.select_autoescape(("html.j2",)),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        loader=jinja2.FunctionLoader(lambda name: files.joinpath(name).read_text("utf-8")),
    )
    environment.filters |= {
        "percent": _percent,
        "width": lambda fraction: f"{100 * fraction:.2f}%",
        "data": _data_uri,
        "privileged": lambda written: str(Privileges.from_dict(written)),
    }
    return environment


def _percent(fraction: float) -> str:
    """One decimal, as precise as a count of a few hundred; none if it is zero."""
    return f"{100 * fraction:.1f}".removesuffix(".0") + " %"


def _data_uri(picture: bytes) -> str:
    kind = "png" if picture.startswith(b"\x89PNG") else "webp"
    return f"data:image/{kind};base64," + base64.b64encode(picture).decode()
