"""Tables for programs and for people."""

import csv
import io
import math

from written_runs import record

from sculpt_framework.comparison.statistics import overall, summarize
from sculpt_framework.comparison.tables import (
    Column,
    Table,
    latex_text,
    overall_table,
    results_table,
    runs_table,
    to_csv,
    to_latex,
    to_markdown,
)

RECORDS = [
    *(record([(1.0, 0.2), (50.0, error)], method="ours_1", seed=n) for n, error in enumerate((0.01, 0.02, 0.03))),
    record([(1.0, 0.2), (300.0, 0.05)], method="50% | more"),
    record([], method="broken", failed=True),
]
RESULTS = results_table(
    summarize(RECORDS, "chamfer"),
    {"jar": 0.05},
    {("jar", "ours_1"): 12.3, ("jar", "broken"): math.inf},
    "chamfer",
    "train",
)
PLAIN = Table(caption="c", columns=(Column("a", "A"),), values=[[1]], texts=[["1"]], strong=[False])


def test_csv_has_everything_in_full():
    rows = list(csv.DictReader(io.StringIO(to_csv(RESULTS))))
    assert [row["method"] for row in rows] == ["ours_1", "50% | more", "broken"]
    assert (rows[0]["median"], rows[0]["low"], rows[0]["high"]) == ("0.02", "0.01", "0.03")
    assert (rows[0]["seconds_to_target"], rows[1]["seconds_to_target"], rows[2]["seconds_to_target"]) == (
        "12.3",
        "",
        "inf",
    )
    assert (rows[2]["median"], rows[2]["failures"]) == ("inf", "1")
    assert rows[1]["low"] == ""


def test_markdown_says_it_in_words():
    text = to_markdown(RESULTS)
    lines = text.splitlines()
    head = (
        "| scene | method | runs | failed | median Chamfer distance, scene units | 95 % interval | training time, s |"
    )
    assert lines[2].startswith(head)
    assert lines[4] == "| jar | **ours_1** | 3 | 0 | **0.02** | 0.01 to 0.03 | 50 | 0.05 | 12.3 |"
    assert lines[5] == "| jar | 50% \\| more | 1 | 0 | 0.05 | - | 300 | 0.05 | - |"
    assert lines[6] == "| jar | broken | 1 | 1 | failed | - | - | 0.05 | never |"
    assert all(line.count(" | ") == lines[2].count(" | ") for line in lines[4:] if "\\|" not in line)


def test_columns_with_nothing_in_them_are_left_out():
    text = to_markdown(results_table(summarize(RECORDS[:1], "chamfer"), {}, {}, "chamfer", "train"))
    for heading in ("not known", "interval", "target"):
        assert heading not in text
    assert "**" not in text, "nobody to be better than"


def test_latex_is_escaped_and_needs_no_package():
    text = to_latex(RESULTS)
    assert "\\textbf{ours\\_1} & 3 & 0 & \\textbf{0.02} & 0.01 to 0.03 & 50 & 0.05 & 12.3 \\\\" in text
    assert "50\\% \\textbar{} more" in text
    assert "rule" not in text, "booktabs' commands end in it"
    head = text.split("\\hline\n")[1]
    assert head.count("&") == text.split("\\begin{tabular}{")[1].index("}") - 1
    assert latex_text("a\\b~c^d&e#f{g}") == "a\\textbackslash{}b\\textasciitilde{}c\\textasciicircum{}d\\&e\\#f\\{g\\}"


def test_the_overall_table_counts_wins_and_failures():
    lines = to_markdown(overall_table(overall(RECORDS, "chamfer"), "chamfer", "train")).splitlines()
    assert lines[4] == "| **ours_1** | 1 | 3 | 0 | **1** | 0.02 | 0.01 to 0.03 | 50 |"
    assert lines[6] == "| broken | 1 | 1 | 1 | 0 | failed | - | - |"


def test_every_run_is_listed_with_the_reason_of_its_failure():
    text = to_markdown(runs_table(RECORDS, "chamfer", "train"))
    assert "| broken-jar-0 | jar | broken | 0 | failed | - | it broke |" in text
    assert "| ours_1-jar-2 | jar | ours_1 | 2 | 0.03 | 50 |  |" in text


def test_a_plain_table():
    assert to_markdown(PLAIN) == "c\n\n| A |\n|---|\n| 1 |\n"
    assert to_csv(PLAIN) == "a\n1\n"
