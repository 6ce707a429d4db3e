"""The viewer's panel: status of the node, the legend, and buttons."""

from __future__ import annotations

import html
import queue
from collections.abc import Mapping, Sequence
from enum import Enum

import viser

from tissue_sim.rendering.appearance import SCALE, TISSUE, Colour, tissue_colour

NO_VALUE = "-"
LINES = 3  # lines of the headline
TRANSLUCENT, SOLID = 0.8, 1.0  # opacity of one organ, which shows its inside; of several
LAST = 1e9  # order in the panel: below everything that comes later


class Request(Enum):
    """Request of a button to the node."""

    RESET = "reset"
    RECORD = "start recording"
    STOP_RECORDING = "stop recording"


def status_text(values: Mapping[str, str]) -> str:
    """Return the node's physics status as a Markdown table."""

    def value(key: str, unit: str = "", digits: int | None = None) -> str:
        text = values.get(key, "")
        if digits is not None:
            try:
                text = f"{float(text):.{digits}f}"
            except ValueError:
                text = ""
        return f"{text} {unit}".strip() if text else NO_VALUE

    rows = {
        "Tick rate": value("tick_rate_hz", "Hz", 0),
        "Tick time p50": value("tick_p50_us", "µs", 0),
        "Tick time p99": value("tick_p99_us", "µs", 0),
        "Late ticks": value("overruns"),
        "Real-time factor": value("real_time_factor", digits=2),
        "Region": value("region"),
        "Active nodes": value("active_nodes"),
        "Contacts": value("contact_count"),
        "Force": value("force_n", "N", 2),
    }
    for key in values:
        tool, _, field = key.rpartition(".")
        if field == "state":
            rows[f"Tool {tool}"] = f"{values[key]}, {value(f'{tool}.force_n', 'N', 2)}"
    lines = ["| | |", "|:--|--:|", *(f"| {name} | {text} |" for name, text in rows.items())]
    if values.get("recording"):
        lines += ["", f"Recording to `{values['recording']}`"]
    return "\n".join(lines)


def headline(target: str, level: int, message: str) -> str:
    """Return the node's name, and level and the first part of the message of its DiagnosticStatus, as HTML."""
    first, *others = message.split(";")
    if level == 0:
        return f"<b>/{target}</b> {html.escape(first)}"
    word, more = "warns" if level == 1 else "fails", f" ({len(others)} more below)" if others else ""
    return f'<b>/{target}</b> <span style="color:#c92a2a">{word}: {html.escape(first)}</span>{more}'


def detail(level: int, message: str) -> str:
    """Return the whole message of a DiagnosticStatus, a line for each part of it, as HTML."""
    colour = "inherit" if level == 0 else "#c92a2a"
    lines = "<br>".join(html.escape(part.strip()) for part in message.split(";"))
    return f'<div style="margin:0 0.9em 0.6em;color:{colour};overflow-wrap:anywhere">{lines}</div>'


def headline_html(line: str) -> str:
    """Return a line of HTML of constant height: a growing one would push a button under the mouse."""
    return f'<div style="height:{LINES * 1.5:g}em;line-height:1.5;overflow-y:auto;margin:0 0.9em 0.6em">{line}</div>'


def organs_html(names: Sequence[str]) -> str:
    """Return the names of a scene's organs and their colours at rest."""
    rows = "".join(
        '<div style="display:flex;align-items:center;font-size:12px"><span style="width:14px;height:14px;'
        f'margin-right:6px;background:rgb{tissue_colour(name)}"></span>{html.escape(name)}</div>'
        for name in names
    )
    return f'<div style="padding:0 0.9em 0.6em">{rows}</div>'


def legend_html() -> str:
    """Return the colours of the organ and the displacements that they stand for."""

    def swatch(colour: Colour, text: str) -> str:
        return (
            f'<div style="flex:1;text-align:center"><div style="height:14px;background:rgb{colour}"></div>'
            f'<span style="font-size:11px">{text}</span></div>'
        )

    cells = swatch(TISSUE, "0") + "".join(swatch(colour, f"{level:g}") for level, colour in SCALE)
    return (
        '<div style="padding:0 0.9em 0.6em"><div style="font-size:12px;padding-bottom:3px">'
        f'Displacement from rest, mm or more</div><div style="display:flex">{cells}</div></div>'
    )


class Panel:
    """The panel; requests of its buttons wait in `requests`."""

    def __init__(self, server: viser.ViserServer) -> None:
        self.requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
        gui = server.gui
        self._headline = gui.add_html(headline_html(""))
        self._status = gui.add_markdown("", visible=False, order=LAST)
        self._detail = gui.add_html("", visible=False, order=LAST - 1.0)
        self._organs = gui.add_html("", visible=False)
        gui.add_html(legend_html())
        self.opacity = gui.add_slider(
            "Opacity", min=0.2, max=1.0, step=0.05, initial_value=TRANSLUCENT, hint="Of the tissue over its interior"
        )
        self._reset = gui.add_button("Reset", hint="Return to the rest shape")
        self._record = gui.add_button("Record", hint="Start or stop recording a bag")
        self._recording = False
        self._reset.disabled = self._record.disabled = True
        self._reset.on_click(lambda _: self.requests.put(Request.RESET))
        self._record.on_click(
            lambda _: self.requests.put(Request.STOP_RECORDING if self._recording else Request.RECORD)
        )
        self._said: tuple[str, Mapping[str, str], str] = ("", {}, "")

    def name(self, organs: Sequence[str]) -> None:
        """Name the organs of a scene beside their colours; none for a single organ."""
        self._organs.content, self._organs.visible = organs_html(organs), bool(organs)

    def say(self, headline: str, values: Mapping[str, str], detail: str = "") -> None:
        """Show a headline and details (HTML), and the node's values, if there are any.

        Parts of varying length come last, where they move nothing.
        """
        if (headline, values, detail) == self._said:
            return
        self._said = headline, dict(values), detail
        self._headline.content = headline_html(headline)
        self._detail.content, self._detail.visible = detail, bool(detail)
        self._status.visible = bool(values)
        if values:
            self._status.content = status_text(values)
        self._recording = bool(values.get("recording"))
        self._record.label = "Stop recording" if self._recording else "Record"
        self._reset.disabled = self._record.disabled = not values
