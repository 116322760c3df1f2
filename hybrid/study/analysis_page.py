"""The analysis of a study as a page that requires no server, and as tables for spreadsheets and papers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from compose.base.files import json_text, write_text
from hybrid.evaluation.evaluation_page import rendered
from hybrid.evaluation.result_plots import OTHER_COLOUR, OURS_COLOUR, new_axes, svg_of
from hybrid.study.analysis import p_text
from hybrid.study.observations import write_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Row = dict[str, Any]
# What LaTeX takes for commands, and how it writes them.
_LATEX = {
    "\\": r"\textbackslash{}",
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
}
# Bars of a plot in which names can still be read.
_MOST_BARS = 40
# Votes that have a name in the legend.
_MOST_NAMED = 11


def write_page(folder: Path, found: Row) -> None:
    """Writes index.html, analysis.json, table.csv and table.tex of what `analysis.analyse` found.

    The tables hold the quality of each condition and the comparison of each pair.
    """
    tables = tables_of(found)
    page = rendered(
        "analysis.html",
        "hybrid.study",
        title="Analysis of " + ("votes" if found["kind"] == "ratings" else "choices between two"),
        sentences=found["sentences"],
        plots=[Markup(plot) for plot in plots(found)],
        tables=tables,
        screening=screening_table(found),
        found=found,
        percent=f"{100 * found['settings']['level']:g} %",
    )
    csv_rows: list[Sequence[object]] = []
    for table in tables:
        csv_rows += [[table["title"]], table["columns"], *table["rows"], []]
    write_text(folder / "index.html", page)
    write_text(folder / "analysis.json", json_text(found))
    write_table(folder / "table.csv", csv_rows[:-1])
    write_text(folder / "table.tex", "\n".join(latex_table(table) for table in tables))


def tables_of(found: Row) -> list[Row]:
    """Qualities of conditions and comparisons of pairs: `title`, `columns`, `rows` of texts, and `main`.

    Those that are not `main` are of single groups or scenes, and stand folded up in the page.
    """
    if found["kind"] == "choices":
        tables = []
        for number, scale in enumerate(found["scales"]):
            of = f" of {scale['group']}" if scale["group"] else ""
            tables.append(_table(f"Quality{of}, JOD", scale["qualities"], _QUALITIES, not number))
            title = f"Pairs{of}; {scale['observers']} observers"
            tables.append(_table(title, scale["pairs"], _CHOSEN_PAIRS, not number))
        return tables
    scores, comparison = found["scores"], found["comparison"]
    tables = [_table("Mean opinion scores", [row for row in scores if not row["scene"]], _SCORES)]
    if comparison:
        title, whole = f"Pairs; {len(comparison['observers'])} observers", comparison["omnibus"]
        if whole:
            corrected = f", epsilon {whole['epsilon']:.2f}" if "epsilon" in whole else ""
            title += f"; {whole['test']}: {whole['statistic']:.2f}, {p_text(whole['p'])}{corrected}"
        tables.append(_table(title, comparison["pairs"], _RATED_PAIRS))
    of_scenes = [row for row in scores if row["scene"]]
    if of_scenes:
        tables.append(_table("Mean opinion scores of scenes", of_scenes, _SCORES, main=False))
    return tables


# What rows hold, by the titles of columns.
_RANGE = {"low": "low", "high": "high"}
_QUALITIES = {"condition": "condition", "JOD": "jod", **_RANGE}
_PAIR = {"better": "first", "worse": "second"}
_CHOSEN_PAIRS = {**_PAIR, "JOD": "difference", **_RANGE, "p": "p_holm", "chosen": "share", "trials": "trials"}
_CHOSEN_PAIRS |= {"binomial p": "binomial_p_holm", "verdict": "verdict"}
_RATED_PAIRS = {**_PAIR, "difference": "difference", **_RANGE, "test": "test", "p": "p_holm"}
_RATED_PAIRS |= {name: name for name in ("d", "d_z", "effect", "power", "detectable", "verdict")}
_SCORES = {name: name for name in ("condition", "scene", "observers", "votes")} | {"MOS": "mean"} | _RANGE
_SCORES |= {"low (votes)": "votes_low", "high (votes)": "votes_high"}
_OBSERVERS = {
    "choices": {name: name for name in ("observer", "answers", "agreement")},
    "ratings": {"observer": "observer", "votes": "votes", "far above": "above", "far below": "below"}
    | {"mean": "mean", "sd": "sd"},
}


def _table(title: str, rows: list[Row], columns: dict[str, str], main: bool = True) -> Row:
    texts = [[_text(row, name) for name in columns.values()] for row in rows]
    return {"title": title, "columns": list(columns), "rows": texts, "main": main}


def _text(row: Row, name: str) -> str:
    if name == "verdict":
        return " and ".join(one for one in ("different", "equivalent") if row[one]) or "open"
    value = row[name]
    if value is None:
        return "-"
    if name.endswith("p_holm"):
        return p_text(value)
    if name == "share":
        return f"{100 * value:.0f} %"
    return f"{value:.2f}" if isinstance(value, float) else str(value) or "all"


def screening_table(found: Row) -> Row:
    """What screening looked at, of each observer."""
    table = _table("", found["screening"], _OBSERVERS[found["kind"]])
    for row, cells in zip(found["screening"], table["rows"], strict=True):
        kept = "kept all the same" if row["observer"] not in found["dropped"] else "left out"
        cells.append(kept if row["dropped"] else "")
    table["columns"].append("")
    return table


def latex_table(table: Row) -> str:
    """A table in plain LaTeX, with lines where booktabs has its rules."""
    cells = [" & ".join(map(latex_text, row)) + r" \\" for row in [table["columns"], *table["rows"]]]
    lines = [
        f"% {table['title']}",
        rf"\begin{{tabular}}{{l*{{{len(table['columns']) - 1}}}{{r}}}}",
        r"\hline",
        cells[0],
        r"\hline",
        *cells[1:],
        r"\hline",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def latex_text(text: str) -> str:
    """A text as LaTeX prints it."""
    return "".join(_LATEX.get(sign, sign) for sign in text)


def plots(found: Row) -> list[str]:
    """Qualities with their intervals, differences of pairs with the margin, and votes, as SVG elements."""
    margin = found["settings"]["margin"]
    if found["kind"] == "choices":
        told, labels = found["scales"], [f" of {s['group']}" if s["group"] else "" for s in found["scales"]]
        drawn = [
            _intervals(s["qualities"], "jod", f"quality{of}, JOD") for s, of in zip(told, labels, strict=True)
        ]
        if len(told[0]["pairs"]) <= _MOST_BARS:
            drawn.insert(1, _differences(told[0]["pairs"], margin, f"difference{labels[0]}, JOD"))
        return drawn
    scores = [row for row in found["scores"] if row["condition"] and not row["scene"]]
    drawn = [
        _intervals(sorted(scores, key=lambda row: -row["mean"]), "mean", "mean opinion score"),
        _votes(found),
    ]
    if found["comparison"] and len(found["comparison"]["pairs"]) <= _MOST_BARS:
        drawn.append(_differences(found["comparison"]["pairs"], margin, "difference, steps of the scale"))
    return drawn


def _bars(count: int) -> Axes:
    axes = new_axes(1.4 + 0.32 * count)
    axes.invert_yaxis()
    axes.margins(y=0.5 / count)
    return axes


def _intervals(rows: list[Row], name: str, label: str) -> str:
    rows = rows[:_MOST_BARS]
    axes = _bars(len(rows))
    for at, row in enumerate(rows):
        _interval(axes, at, row, row[name], OTHER_COLOUR)
    axes.set_yticks(range(len(rows)), [_short(row["condition"]) for row in rows])
    axes.set_xlabel(label)
    return svg_of(axes)


def _differences(rows: list[Row], margin: float, label: str) -> str:
    """Differences of pairs: red if they differ; the grey band is what counts as equivalent."""
    axes = _bars(len(rows))
    axes.axvspan(-margin, margin, color="#ddd", lw=0)
    axes.axvline(0, color="#888", lw=0.8)
    for at, row in enumerate(rows):
        _interval(axes, at, row, row["difference"], OURS_COLOUR if row["different"] else OTHER_COLOUR)
    names = [f"{_short(row['first'])} − {_short(row['second'])}" for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.set_xlabel(label)
    return svg_of(axes)


def _interval(axes: Axes, at: int, row: Row, value: float, colour: str) -> None:
    if row["low"] is not None:
        axes.plot([row["low"], row["high"]], [at, at], color=colour, lw=1.5, solid_capstyle="butt")
    axes.plot(value, at, "o", color=colour, ms=5)


def _votes(found: Row) -> str:
    """Shares of the votes of each condition as stacked bars, from the worst vote to the best."""
    from matplotlib import colormaps

    rows = found["votes"][:_MOST_BARS]
    order = {row["condition"]: -row["mean"] for row in found["scores"] if not row["scene"]}
    rows = sorted(rows, key=lambda row: order[row["condition"]])
    values = sorted({vote for row in rows for vote in row["counts"]}, key=float)
    # A continuous scale has too many.
    named = len(values) <= _MOST_NAMED
    axes = _bars(len(rows))
    left = [0.0] * len(rows)
    for n, vote in enumerate(values):
        colour = colormaps["RdYlBu"](0.1 + 0.8 * n / max(len(values) - 1, 1))
        shares = [100 * row["counts"].get(vote, 0) / sum(row["counts"].values()) for row in rows]
        axes.barh(range(len(rows)), shares, 0.7, left, color=colour, label=vote if named else None)
        left = [a + b for a, b in zip(left, shares, strict=True)]
    axes.set_yticks(range(len(rows)), [_short(row["condition"]) for row in rows])
    axes.set_xlabel("votes, %")
    axes.set_xlim(0, 100)
    if named:
        axes.legend(ncols=len(values), loc="lower center", bbox_to_anchor=(0.5, 1), frameon=False, fontsize=8)
    return svg_of(axes)


def _short(name: str) -> str:
    # Dollar signs would begin formulas.
    return (name if len(name) <= 30 else f"{name[:29]}…").replace("$", r"\$")
