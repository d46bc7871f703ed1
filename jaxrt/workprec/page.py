"""Reports as one page of HTML that needs no network: every picture is in it."""

from __future__ import annotations

import base64
import html
import io
import re
import string
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..files.image import to_srgb
from .curve import Curve, Row
from .figure import INK, figure, pyplot
from .report import Report
from .words import HEADS, cells, percent, said_of, seconds, sentence

PALE = "#dddddd"
"""Of text and axes on dark ground."""

MAP, RANGE = "magma", (1e-3, 1.0)
"""Colours of an error map, and the relative errors at both ends, between which it is logarithmic."""


def page(reports: Sequence[Report], title: str = "Work and precision") -> str:
    """The page of all scenes."""
    template = string.Template((Path(__file__).parent / "page.html").read_text(encoding="utf-8"))
    told = ", ".join(f"{key} {value}" for key, value in reports[0].circumstances.items()) if reports else ""
    ramp = ", ".join("#{:02x}{:02x}{:02x}".format(*c) for c in _colours(np.linspace(0.0, 1.0, 9)))
    links = [f'<a href="#{html.escape(r.name)}">{html.escape(r.name)}</a>' for r in reports if len(reports) > 1]
    return template.substitute(
        title=html.escape(title), ramp=ramp, links=" ".join(links), circumstances=html.escape(told),
        scenes="\n".join(_scene(report) for report in reports),
    )  # fmt: skip


def _scene(report: Report) -> str:
    width, height = report.size
    reference = f"Reference: {report.reference.by}, known to {percent(report.reference.error)}"
    known = f"{reference}; {width} × {height} pixels."
    left = f" Left out for want of time: {', '.join(report.left_out)}." if report.left_out else ""
    return f"""<section id="{html.escape(report.name)}">
<h2>{html.escape(report.name)}</h2>
<p>{html.escape(sentence(report))}</p>
<p class="soft">{html.escape(known + left)}</p>
{_maps(report)}
<h3>Error against seconds, depth, and the field on its own</h3>
<div class="scroll curves">{_curves(report)}</div>
<h3>Pictures along the curves</h3>
{"".join(_strip(curve) for curve in report.of("samples") + report.of("depth") + report.of("effects"))}
<h3>What each costs</h3>
<div class="scroll">{_table(report)}</div>
</section>"""


def _maps(report: Report) -> str:
    """The reference, and error maps of all methods at about equal time."""
    shown = [_figure(report.reference.image, "<b>the reference</b>")]
    curves = [curve for curve in report.of("samples") if curve.rows]
    time = min((curve.rows[-1].seconds for curve in curves), default=0.0)
    for curve in curves:
        row = min(curve.rows, key=lambda row: abs(np.log(row.seconds / time)))
        if row.image is not None:
            caption = f"<b>error of {html.escape(curve.name)}</b><br>{_told(row)}"
            shown.append(_figure(_error_map(row.image, report.reference.image), caption))
    scale = (
        f'<div class="scale"><span>{percent(RANGE[0])}</span><i></i><span>{percent(RANGE[1])} of a pixel</span></div>'
    )
    return f'<div class="pictures">{"".join(shown)}</div>{scale if len(shown) > 1 else ""}'


def _error_map(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Each pixel's share of √relMSE as colours, uint8 (H, W, 3)."""
    epsilon = max(0.01 * float((reference**2).mean()), 1e-300)
    off = np.sqrt(((image - reference) ** 2 / (reference**2 + epsilon)).mean(-1))
    low, high = np.log(RANGE)
    return _colours((np.log(np.maximum(off, 1e-12)) - low) / (high - low))


def _colours(share: np.ndarray) -> np.ndarray:
    return (255.0 * pyplot().get_cmap(MAP)(np.clip(share, 0.0, 1.0))[..., :3] + 0.5).astype(np.uint8)


def _curves(report: Report) -> str:
    drawn = figure([report], "svg", ground=False)
    light, dark = (_data(drawn.replace(INK.encode(), ink.encode()), "image/svg+xml") for ink in (INK, PALE))
    source = f'<source srcset="{dark}" media="(prefers-color-scheme: dark)">'
    return f'<picture>{source}<img src="{light}" alt="Error against seconds, {html.escape(report.name)}"></picture>'


def _strip(curve: Curve) -> str:
    shown = [_figure(row.image, _told(row)) for row in curve.rows if row.image is not None]
    return f'<p class="soft">{html.escape(curve.name)}</p><div class="strip">{"".join(shown)}</div>' if shown else ""


def _told(row: Row) -> str:
    return f"{percent(row.error)} in {seconds(row.seconds)}<br>{html.escape(row.setting)}"


def _table(report: Report) -> str:
    head = "".join(f"<th>{name}</th>" for name in HEADS)
    lines = []
    for curve in report.curves:
        said = re.sub(r"\^(−?[0-9.]+)", r"<sup>\1</sup>", html.escape(said_of(curve)))
        lines.append(
            f'<tr class="curve"><td colspan="{len(HEADS)}">{html.escape(curve.name)}<span>{said}</span></td></tr>'
        )
        lines += [
            "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells(row)) + "</tr>" for row in curve.rows
        ]
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def _figure(image: np.ndarray, caption: str) -> str:
    """A picture: radiance, or colours where it is of bytes."""
    import PIL.Image

    out = io.BytesIO()
    PIL.Image.fromarray(image if image.dtype == np.uint8 else to_srgb(image)).save(out, "PNG")
    source = _data(out.getvalue(), "image/png")
    return f'<figure><img class="pixels" alt="" src="{source}"><figcaption>{caption}</figcaption></figure>'


def _data(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
