"""What the tables say of known results, and that the paper's figures are those it prints."""

import csv
import io
import json
import math
import statistics
from collections.abc import Mapping
from pathlib import Path

import pytest
from rich.console import Console

from sculpt_framework.cli.ablate import FACTORS
from sculpt_framework.comparison.runs import RunRecord
from sculpt_framework.evaluation.curve import header_line, row_line
from sculpt_framework.experiments.ablation import Ablation, ablation
from sculpt_framework.experiments.ablation_tables import ablation_tables, notes, times_default
from sculpt_framework.experiments.ledger import CellState, Ledger
from sculpt_framework.experiments.matrix import Budget, Cell, Matrix, MatrixScene, cross
from sculpt_framework.experiments.paper import ABLATION, NERF_SYNTHETIC, OMNIOBJECT3D, PaperTable
from sculpt_framework.experiments.plan_check import plan_settings, plan_tables
from sculpt_framework.experiments.results import CellResult, read_results, results_csv
from sculpt_framework.experiments.runner import run_folder
from sculpt_framework.experiments.suite_tables import our_table, paper_table
from sculpt_framework.experiments.suites import Suite
from sculpt_framework.experiments.tables import Table, number, power

SCENES = (MatrixScene(label="dents", data="demo:dents"), MatrixScene(label="blob", data="demo:blob"))
BUDGET = Budget(kind="seconds", amount=40.0)


def put(folder: Path, matrix: Matrix, name: str, chamfer: float | None, **final: float) -> None:
    """A finished run, or a failed one."""
    run_dir = run_folder(folder, next(cell for cell in matrix.cells if cell.name == name))
    run_dir.mkdir(parents=True)
    (run_dir / "config.json").write_text('{"method": "gaussian-sculpting", "data": "demo:dents"}', encoding="utf-8")
    if chamfer is None:
        Ledger(folder).set(name, CellState(status="failed", error="no surface"))
        return
    values = {"chamfer_ps": chamfer, "faces": 1000.0, **final}
    (run_dir / "metrics.json").write_text(json.dumps({"status": "finished", "final": values}), encoding="utf-8")
    Ledger(folder).set(name, CellState(status="finished"))


def rows_of(table: Table) -> dict[str, dict[str, str]]:
    return {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}


@pytest.fixture(scope="module")
def ablated() -> Ablation:
    return ablation("gaussian-sculpting", SCENES[0], [], factors=FACTORS, full=False)


@pytest.fixture
def results(ablated: Ablation, tmp_path: Path) -> tuple[CellResult, ...]:
    """Two scenes, three seeds; without scale twice and three times as bad, without distribution a failure in three."""
    matrix = cross("Test", ablated.settings, SCENES, [BUDGET], [0, 1, 2], [])
    for scene, factor in (("dents", 2.0), ("blob", 4.5)):
        for seed in range(3):
            place = f"{scene}/40s/{{}}/seed-{seed}"
            put(tmp_path, matrix, place.format("default"), 0.01 * (1 + 0.1 * seed), psnr=30.0 + seed)
            put(tmp_path, matrix, place.format("no-scale"), factor * 0.01 * (1 + 0.1 * seed))
            put(tmp_path, matrix, place.format("no-distribution"), None if seed == 0 else 0.02)
            put(tmp_path, matrix, place.format("none"), None)
    return read_results(matrix, tmp_path)


def test_the_summary(ablated: Ablation, results: tuple[CellResult, ...]):
    table = ablation_tables(results, ablated, [BUDGET])[0]
    rows = rows_of(table)
    assert list(rows) == [setting.name for setting in ablated.settings]
    assert rows["default"]["dents"] == "1.100 [1.000 to 1.200]"
    assert rows["default"]["x default"] == "1.00"
    assert rows["no-scale"]["blob"] == "4.950 [4.500 to 5.400]"
    assert rows["no-scale"]["x default"] == "3.00", "the geometric mean of 2 and 4.5"
    assert rows["no-distribution"]["dents"] == "2.000 [2.000 to failed] (1 of 3 failed)"
    assert rows["none"]["dents"] == "failed [failed to failed]"
    assert rows["none"]["x default"] == "failed"
    assert rows["mlp"]["dents"] == "–", "not run"
    ticks = {name: [row[each] for each in ("opacity", "scale", "distribution")] for name, row in rows.items()}
    assert ticks["no-scale"] == ["yes", "no", "yes"]
    assert ticks["no-distribution"] == ["yes", "yes", "no"]
    assert ticks["only-opacity"] == ["yes", "no", "no"]
    assert ticks["none"] == ["no", "no", "no"]
    assert ticks["discrete"] == ["yes", "yes", "yes"]


def test_ratios_are_between_the_same_seeds():
    def record(method: str, seed: int, chamfer: float | None) -> RunRecord:
        final = {"chamfer_ps": chamfer}
        return RunRecord(name="", scene="s", method=method, seed=seed, final=final, failed=chamfer is None)

    found = [record("default", 0, 0.01), record("default", 1, 0.03), record("other", 1, 0.06)]
    assert times_default(found, "other", ["s"]) == pytest.approx(2.0)
    assert times_default(found, "other", ["s", "unseen"]) is None
    assert times_default(found[:1], "other", ["s"]) is None
    assert times_default([*found[:2], record("other", 1, None)], "other", ["s"]) == math.inf


def test_the_paper_is_beside_what_it_measured_only(ablated: Ablation, results: tuple[CellResult, ...]):
    rows = rows_of(ablation_tables(results, ablated, [BUDGET])[0])
    assert {name: row["paper CD"] for name, row in rows.items()} == {
        "default": "1.16",
        "no-scale": "1.58",
        "no-distribution": "1.36",
        "only-opacity": "2.87",
        "none": "11.40",
        **dict.fromkeys(("mlp", "discrete", "no-isolation", "cold-start"), "–"),
    }
    assert rows["none"]["x full"] == "9.83"
    assert any("discrete: Figure" in note for note in notes(ablated))


def test_a_setting_crossed_with_another_factor_has_no_figure_of_the_paper():
    crossed = ablation("gaussian-sculpting", SCENES[0], [], factors=("constraints", "start"), full=True)
    rows = rows_of(ablation_tables((), crossed, [BUDGET])[0])
    assert rows["no-scale"]["paper CD"] == "1.58"
    assert rows["no-scale+cold-start"]["paper CD"] == "–"
    assert rows["no-scale+cold-start"]["scale"] == "no"


def test_the_table_of_a_scene(ablated: Ablation, results: tuple[CellResult, ...]):
    rows = rows_of(ablation_tables(results, ablated, [BUDGET])[1])
    assert rows["default"]["PSNR dB"] == "31.00"
    assert rows["default"]["runs"] == "3"
    assert rows["none"]["runs"] == "3, 3 failed"
    assert rows["none"]["faces"] == "–"
    assert rows["mlp"]["runs"] == "0"


def test_the_csv_has_a_line_per_run(ablated: Ablation, results: tuple[CellResult, ...]):
    lines = list(csv.DictReader(io.StringIO(results_csv(results, ablated.levels))))
    assert len(lines) == 2 * 3 * 9
    of: Mapping[tuple[str, str, str], dict[str, str]] = {
        (line["scene"], line["setting"], line["seed"]): line for line in lines
    }
    assert float(of["dents", "no-scale", "1"]["chamfer"]) == pytest.approx(0.022)
    assert of["dents", "no-scale", "1"]["constraints"] == "no-scale"
    assert of["dents", "no-scale", "1"]["isolation"] == "isolation"
    assert of["blob", "none", "2"]["status"] == "failed"
    assert of["blob", "none", "2"]["error"] == "no surface"
    assert of["blob", "none", "2"]["chamfer"] == ""
    assert of["blob", "mlp", "0"]["status"] == "pending"


def test_a_finished_run_that_left_nothing_is_a_failure(ablated: Ablation, tmp_path: Path):
    matrix = cross("Test", ablated.settings[:1], SCENES[:1], [BUDGET], [0], [])
    Ledger(tmp_path).set(matrix.cells[0].name, CellState(status="finished"))
    (result,) = read_results(matrix, tmp_path)
    assert result.record is not None
    assert result.record.result("chamfer") == math.inf
    assert "is not a run directory" in (result.record.reason or "")


@pytest.mark.parametrize("paper", [NERF_SYNTHETIC, OMNIOBJECT3D], ids=["Table 2", "Table 1"])
def test_the_paper_s_rows_have_the_means_it_prints(paper: PaperTable):
    """Also a proof that the mean of a row with a failure is that of the survivors."""
    for name, row in paper.rows.items():
        assert len(row) == len(paper.objects)
        assert statistics.fmean(value for value in row if value is not None) == pytest.approx(
            paper.means[name], abs=0.006
        ), name


def test_counted_from_the_paper_s_own_figures():
    assert OMNIOBJECT3D.wins() == {
        **dict.fromkeys(("NeRF", "SuGaR", "2DGS", "PGSR"), 0),
        **{"NeuS": 2, "GOF": 3, "GSDF": 2, "Ours": 5},
    }
    assert {name: OMNIOBJECT3D.failures(name) for name in ("NeuS", "GSDF", "Ours")} == {"NeuS": 1, "GSDF": 3, "Ours": 0}
    assert NERF_SYNTHETIC.wins()["Ours 128"] == 3
    rows = rows_of(paper_table(OMNIOBJECT3D))
    assert rows["GSDF"]["Handbag"] == "failed"
    assert rows["GSDF"]["mean"] == "14.68"
    assert float(rows["GSDF"]["median"]) == pytest.approx((9.71 + 10.56) / 2, abs=0.006)
    assert ABLATION["all"] == NERF_SYNTHETIC.means[NERF_SYNTHETIC.ours]


def test_ours_has_the_paper_s_columns(tmp_path: Path):
    scenes = (MatrixScene(label="mic", data="/mic"), MatrixScene(label="ship", data="/ship"))
    suite = Suite(
        name="blender", scenes=scenes, columns=("mic", "ship"), missing=("chair",), paper=NERF_SYNTHETIC, unit=1e-2
    )
    settings = ablation("gaussian-sculpting", SCENES[0], [], factors=("start",), full=False).settings
    matrix = cross("Test", settings, scenes, [None], [0], [])
    put(tmp_path, matrix, "mic/full/default/seed-0", 0.013)
    put(tmp_path, matrix, "mic/full/cold-start/seed-0", None)
    rows = rows_of(our_table(read_results(matrix, tmp_path), suite, ["default", "cold-start"]))
    assert list(rows["default"]) == ["method", *NERF_SYNTHETIC.objects, "mean", "median", "failures", "wins"]
    assert [rows["default"][name] for name in ("Mic", "Chair", "mean", "failures", "wins")] == [
        *("1.30", "–", "1.30", "0", "1"),
    ]
    assert [rows["cold-start"][name] for name in ("Mic", "mean", "failures", "wins")] == ["failed", "failed", "1", "0"]


def test_text():
    table = Table(title="T", columns=("a", "b"), rows=(("x|y", "1"),))
    assert table.markdown() == "### T\n\n| a | b |\n| --- | ---: |\n| x\\|y | 1 |\n"
    assert [number(value, 2) for value in (1.005, None, math.inf, math.nan)] == ["1.00", "–", "failed", "–"]
    told = io.StringIO()
    Table(title="T", columns=("a [x]",), rows=(("[/usr/lib/libx.so]",),)).show(Console(file=told, width=80))
    assert "a [x]" in told.getvalue()
    assert "[/usr/lib/libx.so]" in told.getvalue()
    assert number(0.0123, 1, times=100.0) == "1.2"
    assert [power(unit) for unit in (1e-2, 1e-3)] == ["1e-2", "1e-3"]


def test_seconds_are_of_all_processes_of_a_run_and_whole_numbers_are_whole(tmp_path: Path):
    settings = plan_settings("gaussian-sculpting")
    matrix = cross("Test", settings, SCENES[:1], [None], [0], [])
    for setting in settings:
        put(tmp_path, matrix, f"dents/full/{setting.name}/seed-0", 0.01, t_train_s=9.0, t_wall_s=5.0, t_cpu_s=7.0)
    # The planned run was interrupted after 30 s of CPU time and resumed.
    rows = [
        {"t_train_s": 4.0, "t_wall_s": 20.0, "t_cpu_s": 30.0},
        {"t_train_s": 9.0, "t_wall_s": 5.0, "t_cpu_s": 7.0},
    ]
    run = run_folder(tmp_path, matrix.cells[0])
    (run / "curve.csv").write_text(header_line() + "".join(map(row_line, rows)), encoding="utf-8")
    metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    metrics["final"]["faces"] = 12345678
    (run / "metrics.json").write_text(json.dumps(metrics), encoding="utf-8")
    results = read_results(matrix, tmp_path)
    (table,) = plan_tables(results, [None])
    assert table.rows[0][7:10] == ("37.0", "7.0", "5.29")
    planned = next(csv.DictReader(io.StringIO(results_csv(results, {}))))
    assert [planned[name] for name in ("t_train_s", "t_wall_s", "t_cpu_s")] == ["9", "25", "37"]
    assert planned["faces"] == "12345678"


def test_plans_of_several_budgets_have_a_table_each(tmp_path: Path):
    settings = plan_settings("gaussian-sculpting")
    budgets = [Budget(kind="seconds", amount=40.0), Budget(kind="steps", amount=9.0)]
    matrix = cross("Test", settings, SCENES[:1], budgets, [0], [])
    for cell in matrix.cells:
        put(tmp_path, matrix, cell.name, 0.01 if cell.timed else 0.03)
    timed, counted = plan_tables(read_results(matrix, tmp_path), budgets)
    assert [table.title.rpartition(", ")[2] for table in (timed, counted)] == ["40 s a run", "9 outer steps a run"]
    assert [table.rows[0][1] for table in (timed, counted)] == ["1.000", "3.000"]


def test_failures_count_in_the_table_of_plans():
    def result(setting: str, seed: int, chamfer: float | None) -> CellResult:
        cell = Cell(name=f"jar/{setting}/{seed}", scene="jar", setting=setting, budget=None, seed=seed, words=())
        final = {} if chamfer is None else {"chamfer_ps": chamfer, "t_train_s": 10.0}
        record = RunRecord(name=cell.name, scene="jar", method=setting, final=final, failed=chamfer is None)
        return CellResult(cell=cell, state=CellState(status="finished"), record=record)

    results = [result("planned", seed, None if seed else 0.01) for seed in range(3)]
    results += [result("everything", seed, 0.01) for seed in range(3)]
    (row, middle) = plan_tables(results, [None])[0].rows
    assert row[1:4] == ("failed", "1.000", "failed")
    assert middle[3] == "failed"
    assert row[4:7] == ("10.0", "10.0", "1.00")
