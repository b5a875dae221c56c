"""Curves as other libraries write them: values by step, runs by label, one-line errors."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from bojax.report.comparing.build import compare
from bojax.report.comparing.logs.grouping import rows_of
from bojax.report.comparing.logs.opening import label_and_run, opened
from tests.report.synthetic import write_learning
from tests.report.test_report import Page
from tests.transcript import cases

MONITOR = """\
#{"t_start": 1700000000.1, "env_id": "Pendulum-v1"}
r,l,t
-1200.5,200,0.5
-900.25,200,1.0
-300.0,180,1.4
"""
WANDB = """\
"Step","ppo-seed-0 - eval/return","ppo-seed-0 - eval/return__MIN","ppo-seed-0 - eval/return__MAX",\
"ppo-seed-1 - eval/return","ppo-seed-1 - eval/return__MIN","ppo-seed-1 - eval/return__MAX"
"1000","12.5","12.5","12.5","","",""
"2000","20.1","20.1","20.1","18.0","18.0","18.0"
"3000","NaN","NaN","NaN","25.5","25.5","25.5"
"""
PROGRESS = """\
time/fps,rollout/ep_rew_mean,time/total_timesteps,eval/mean_reward,note
100,-5.5,1000,,warm-up
,,1500,7.0,
90,-2.5,2000,,
,,2000,9.0,
"""


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


def monitor(start, rows):
    """A file of `Monitor`: returns, lengths, and seconds at the end of each episode."""
    lines = [f"{value},{length},{seconds}" for value, length, seconds in rows]
    return "\n".join([f"#{json.dumps({'t_start': start, 'env_id': None})}", "r,l,t", *lines]) + "\n"


def curves(*paths, metric="return", phase="train", axis="step", column=None):
    """Steps and values by label and run."""
    logs = [log for path in paths for log in opened(path).logs]
    return {
        rows.label: {run: (x.tolist(), y.tolist()) for run, (x, y) in rows.runs.items()}
        for _, rows in rows_of(logs, metric, phase, axis, column)
    }


def event(step, tag, value):
    """An event with a scalar, as `torch.utils.tensorboard` and tensorboardX write it."""
    proto = pytest.importorskip("tensorboardX.proto.event_pb2")
    found = proto.Event(step=step, wall_time=1.0)
    found.summary.value.add(tag=tag, simple_value=value)
    return found


def write_events(path, events):
    """A TFRecord file; the checksums are not those of the content."""
    path.parent.mkdir(parents=True, exist_ok=True)
    records = [each.SerializeToString() for each in events]
    path.write_bytes(b"".join(struct.pack("<QI", len(each), 0) + each + bytes(4) for each in records))
    return path


class TestNames:
    @pytest.mark.parametrize(
        ("name", "found"),
        [
            ("ppo-seed-0", ("ppo", 0)),
            ("ppo_seed=12", ("ppo", 12)),
            ("ppo/seed-3", ("ppo", 3)),
            ("sac_s20", ("sac", 20)),
            ("ppo run 4", ("ppo", 4)),
            ("PPO_1", ("PPO", 1)),
            ("CartPole-v1_2", ("CartPole-v1", 2)),
            ("CartPole-v1__ppo__3__1700000000", ("CartPole-v1__ppo", 3)),
            ("seed-3", ("", 3)),
            ("ppo/7", ("ppo", 7)),
            # No number of a run: a version, a size, a rate, a random name
            ("CartPole-v1", ("CartPole-v1", None)),
            ("ppo2", ("ppo2", None)),
            ("dqn-64", ("dqn-64", None)),
            ("lr-1e-3", ("lr-1e-3", None)),
            ("glad-sky-12", ("glad-sky-12", None)),
            ("tests1", ("tests1", None)),
        ],
    )
    def test_a_number_of_a_run_is_told_from_other_numbers(self, name, found):
        assert label_and_run(name) == found


class TestStableBaselines3:
    def test_a_monitor_file_is_one_run_by_steps_or_episodes(self, tmp_path):
        path = write(tmp_path / "ppo" / "0.monitor.csv", MONITOR)
        returns = [-1200.5, -900.25, -300.0]
        assert curves(path) == {"ppo": {0: ([200, 400, 580], returns)}}
        assert curves(path, axis="episode") == {"ppo": {0: ([1, 2, 3], returns)}}
        assert curves(path, metric="length") == {"ppo": {0: ([200, 400, 580], [200, 200, 180])}}

    def test_parallel_environments_of_a_folder_are_one_run_in_the_order_of_time(self, tmp_path):
        random = np.random.default_rng(0)
        episodes = []
        for rank, start in enumerate((50.0, 50.25, 51.0)):
            seconds = np.cumsum(random.uniform(0.1, 2.0, 12))
            rows = [(float(random.normal()), int(random.integers(1, 9)), float(at)) for at in seconds]
            write(tmp_path / "ppo" / f"{rank}.monitor.csv", monitor(start, rows))
            episodes += [(start + at, value, length) for value, length, at in rows]
        steps, expected = 0, []
        for _, value, length in sorted(episodes):
            steps += length
            expected.append((steps, value))
        ((found,),) = ([*runs.values()] for runs in curves(tmp_path / "ppo").values())
        assert [*zip(*found, strict=True)] == expected

    def test_progress_has_a_curve_for_each_column(self, tmp_path):
        path = write(tmp_path / "ppo_3" / "progress.csv", PROGRESS)
        assert curves(path) == {"ppo": {3: ([1000, 2000], [-5.5, -2.5])}}
        assert curves(path, phase="test") == {"ppo": {3: ([1500, 2000], [7, 9])}}
        assert curves(path, column="time/fps") == {"ppo": {3: ([1000, 2000], [100, 90])}}

    def test_evaluations_are_means_over_their_episodes(self, tmp_path):
        results = np.random.default_rng(0).normal(size=(3, 5))
        np.savez(tmp_path / "evaluations.npz", timesteps=[10, 20, 30], results=results, successes=results > 0)
        for phase in ("train", "test"):
            ((_, runs),) = curves(tmp_path / "evaluations.npz", phase=phase).items()
            assert runs[0][0] == [10, 20, 30] and runs[0][1] == pytest.approx(results.mean(axis=1))
        ((_, runs),) = curves(tmp_path / "evaluations.npz", metric="success").items()
        assert runs[0][1] == pytest.approx((results > 0).mean(axis=1))

    def test_a_folder_of_runs_has_labels_and_numbers_from_its_folders(self, tmp_path):
        for name in ("ppo/seed-0", "ppo/seed-1", "dqn/seed-5"):
            write(tmp_path / "logs" / name / "monitor.csv", MONITOR)
        assert {label: [*runs] for label, runs in curves(tmp_path / "logs").items()} == {
            "dqn": [5],
            "ppo": [0, 1],
        }
        every = sorted((tmp_path / "logs").glob("*/*"))
        assert curves(*every) == curves(tmp_path / "logs")
        assert [*curves(tmp_path / "logs" / "ppo")] == ["ppo"]

    def test_training_is_preferred_to_evaluations_unless_tests_are_asked_for(self, tmp_path):
        write(tmp_path / "a" / "monitor.csv", MONITOR)
        write(tmp_path / "a" / "progress.csv", PROGRESS)
        np.savez(tmp_path / "a" / "evaluations.npz", timesteps=[7], results=[[1.0, 3.0]])
        assert curves(tmp_path / "a")["a"][0][0] == [200, 400, 580]
        assert curves(tmp_path / "a", phase="test") == {"a": {0: ([7], [2])}}

    def test_a_name_makes_all_runs_of_a_path_one_method(self, here):
        for name in ("glad-sky-12", "bold-sea-3"):
            write(here / "logs" / name / "monitor.csv", MONITOR)
        assert [len(runs) for runs in curves(here / "logs").values()] == [1, 1]
        assert [*curves(Path("mine=logs"))["mine"]] == [0, 1]


class TestWeightsAndBiases:
    def test_bounds_and_empty_cells_are_ignored(self, tmp_path):
        path = write(tmp_path / "export.csv", WANDB)
        assert curves(path) == {"ppo": {0: ([1000, 2000], [12.5, 20.1]), 1: ([2000, 3000], [18.0, 25.5])}}

    def test_runs_with_one_name_are_several_runs(self, tmp_path):
        path = write(tmp_path / "export.csv", "Step,Group: a - loss,Group: a - loss\n1,2,3\n2,4,5\n")
        assert curves(path) == {"a": {0: ([1, 2], [2, 4]), 1: ([1, 2], [3, 5])}}

    def test_one_of_several_columns_is_chosen(self, tmp_path):
        path = write(tmp_path / "export.csv", "Step,a - loss,a - return,a - _step,b - return\n1,2,3,1,4\n")
        assert curves(path) == {"a": {0: ([1], [3])}, "b": {0: ([1], [4])}}


class TestTensorBoard:
    def test_scalars_of_its_writer_are_read(self, tmp_path):
        writer_of = pytest.importorskip("tensorboardX").SummaryWriter
        for run in (1, 2):
            with writer_of(str(tmp_path / f"PPO_{run}")) as writer:
                for step in (64, 128, 192):
                    writer.add_scalar("rollout/ep_rew_mean", step / 64 + run, step)
                    writer.add_scalar("train/loss", -step, step)
                    writer.add_histogram("weights", np.arange(9.0), step)
                writer.add_text("note", "a note")
        assert curves(tmp_path) == {
            "PPO": {run: ([64, 128, 192], [1 + run, 2 + run, 3 + run]) for run in (1, 2)}
        }
        assert curves(tmp_path / "PPO_1", column="train/loss") == {
            "PPO": {1: ([64, 128, 192], [-64, -128, -192])}
        }

    def test_scalars_that_tensorflow_2_writes_as_tensors_are_read(self, tmp_path):
        proto = pytest.importorskip("tensorboardX.proto.event_pb2")
        events = []
        for step, value in ((1, 0.5), (2, 1.5), (3, 2.5)):
            each = proto.Event(step=step)
            scalar = each.summary.value.add(tag="return")
            if step == 1:  # later values have no description
                scalar.metadata.plugin_data.plugin_name = "scalars"
            scalar.tensor.dtype = 1
            if step == 3:
                scalar.tensor.float_val.append(value)
            else:
                scalar.tensor.tensor_content = struct.pack("<f", value)
            events.append(each)
        path = write_events(tmp_path / "keras" / "events.out.tfevents.1", events)
        assert curves(path) == {"keras": {0: ([1, 2, 3], [0.5, 1.5, 2.5])}}

    def test_a_run_that_was_logged_twice_counts_with_its_last_value(self, tmp_path):
        folder = tmp_path / "a"
        path = write_events(folder / "events.out.tfevents.1", [event(n, "return", n) for n in (1, 2)])
        write_events(folder / "events.out.tfevents.2", [event(2, "return", 5.0), event(3, "return", 6.0)])
        assert curves(folder) == {"a": {0: ([1, 2, 3], [1, 5, 6])}}
        path.write_bytes(path.read_bytes()[:-3])  # a record that is still being written is left out
        assert curves(path) == {"a": {0: ([1], [1])}}


class TestScores:
    def test_matrices_are_scores_by_task(self, tmp_path):
        random = np.random.default_rng(0)
        a, b = random.normal(size=(5, 2)), random.normal(size=(4, 2))
        np.savez(tmp_path / "scores.npz", a=a, b=b, games=["pong", "breakout"])
        rows = opened(tmp_path / "scores.npz").rows
        found = {(each.label, each.task): [float(y[0]) for _, y in each.runs.values()] for each in rows}
        assert found == {
            (label, game): matrix[:, place].tolist()
            for label, matrix in (("a", a), ("b", b))
            for place, game in enumerate(("pong", "breakout"))
        }
        page = Page(compare([], [tmp_path / "scores.npz"], tmp_path / "out").read_text(encoding="utf-8"))
        assert "P(better than a)" in page.text and "All tasks" in page.text and "pong" in page.text
        assert "budget" not in page.text.lower().split("methods")[0]


class TestPage:
    def test_logs_stand_beside_results_by_step(self, here):
        folder = write_learning(here / "car", runs=3)
        for run in range(3):
            rows = [(-float(100 - 10 * n - run), 20, float(n)) for n in range(9)]
            write(here / "logs" / f"ppo_{run}" / "monitor.csv", monitor(5.0, rows))
        export = write(here / "export.csv", WANDB.replace("ppo", "sac"))
        page = compare([folder], [here / "logs", export], here / "out")
        text = Page(page.read_text(encoding="utf-8")).text
        assert "ppo" in text and "sac" in text and "By environment step" in text
        assert "ppo (r)" in text and "sac (eval/return)" in text


MISTAKES = """\
--csv back
=> back/progress.csv: rollout/ep_rew_mean: steps go backwards, from 1,000 to 900;
--csv car
=> car: has no curves; allowed: a folder with *monitor.csv, progress.csv, evaluat
--csv text.csv
=> text.csv: line 3: ppo-seed-0 - eval/return: got "many"; allowed: a number
--csv infinite.csv
=> infinite.csv: ppo-seed-0 - eval/return: got inf; allowed: a finite num
--csv headless
=> headless/monitor.csv: line 1: allowed: # and JSON with t_start, as Monitor
--csv lost
=> lost/monitor.csv: no column l; allowed: r, l, t and others
--csv bare
=> bare/monitor.csv: lacks its first line #{...}; allowed: # and JSON
--csv negative
=> negative/monitor.csv: line 4: l: got -5; allowed: a length >= 0
--csv short
=> short/monitor.csv: has no rows; allowed: at least one below the header
--csv two.csv
=> two.csv: no column for return; allowed: --column NAME, with one of loss, val
--csv two.csv --column vlue
=> two.csv: no column vlue; allowed: loss, value; did you
car --csv ppo --column x
=> ppo: no column x; allowed: l, r
--csv progress.csv --x episode
=> progress.csv: rollout/ep_rew_mean is logged by step
--csv progress.csv --column note
=> progress.csv: line 2: note: got "warm-up"; allowed
--csv ppo --phase test
=> ppo: no column for return; allowed: --column NAME, with one
car --column r
=> --column: got r; allowed with logs of other libraries alone
--csv scores.npz
=> scores.npz: b: got shape (3, 1); allowed: the tasks of a, whose shape is
--csv nan.npz
=> nan.npz: a: got nan; allowed: finite numbers
--csv names.npz
=> names.npz: tasks: got 1 different names; allowed: 2, one for each column
--csv words.npz
=> words.npz: a: got <U1; allowed: numbers
--csv pickled.npz
=> pickled.npz: cannot be read without unpickling, or is damaged; allowed:
--csv pickled.npy
=> pickled.npy: cannot be read without unpickling, or is damaged; allowed:
--csv broken.npz
=> broken.npz: cannot be read without unpickling, or is damaged; allowed:
--csv nowhere.npz
=> nowhere.npz: cannot be read: No such file or directory
--csv good.npz ppo
=> ppo: has curves, but good.npz has scores; allowed: one of both
car --csv good.npz
=> good.npz: has one score per run, but emu-q has a curve; allowed: --me
--csv x=good.npz
=> good.npz: has labels of its own; allowed: good.npz without x=
--csv evals
=> evals/evaluations.npz: results: got shape (1, 1); allowed: a row for each of 2
"""


class TestMistakes:
    @pytest.fixture
    def here(self, here):
        write_learning(here / "car", runs=3, tests=0)
        write(here / "ppo" / "monitor.csv", MONITOR)
        write(here / "progress.csv", PROGRESS)
        write(here / "back" / "progress.csv", PROGRESS.replace("2000,,", "900,,"))
        write(here / "text.csv", WANDB.replace("20.1", "many"))
        write(here / "infinite.csv", WANDB.replace("20.1", "Infinity"))
        write(here / "headless" / "monitor.csv", MONITOR.replace('"t_start"', '"start"'))
        write(here / "lost" / "monitor.csv", MONITOR.replace("r,l,t", "r,length,t"))
        write(here / "bare" / "monitor.csv", MONITOR.partition("\n")[2])
        write(here / "negative" / "monitor.csv", MONITOR.replace("-900.25,200", "-900.25,-5"))
        write(here / "short" / "monitor.csv", "\n".join(MONITOR.split("\n")[:2]))
        write(here / "two.csv", "Step,a - loss,a - value\n1,2,3\n")
        np.savez(here / "scores.npz", a=np.zeros((3, 2)), b=np.zeros((3, 1)))
        np.savez(here / "nan.npz", a=np.array([[1.0, np.nan]]))
        np.savez(here / "names.npz", a=np.zeros((3, 2)), tasks=["x"])
        np.savez(here / "words.npz", a=np.array(["x"]))
        np.savez(here / "good.npz", a=np.zeros(3), b=np.ones(3))
        np.savez(here / "pickled.npz", a=np.array([{}], dtype=object))
        np.save(here / "pickled.npy", np.array({"a": np.zeros((3, 2))}, dtype=object))
        write(here / "broken.npz", "no archive")
        (here / "evals").mkdir()
        np.savez(here / "evals" / "evaluations.npz", timesteps=[1, 2], results=[[1.0]])
        return here

    def test_a_mistake_is_one_line_and_writes_nothing(self, here, refusal):
        for words, message in cases(MISTAKES):
            assert refusal(f"compare {words}").startswith(message)

    def test_an_event_file_without_scalars_or_with_damage_is_refused(self, here, refusal):
        proto = pytest.importorskip("tensorboardX.proto.event_pb2")
        write_events(here / "empty" / "events.out.tfevents.1", [proto.Event(file_version="brain.Event:2")])
        message = "empty: its event files have no scalars; allowed: a folder"
        assert refusal("compare --csv empty").startswith(message)
        path = write_events(here / "bad" / "events.out.tfevents.1", [event(1, "return", 1.0)])
        path.write_bytes(path.read_bytes()[:12] + b"\xff" * 40)
        message = "bad/events.out.tfevents.1: is damaged; allowed: an event"
        assert refusal("compare --csv bad").startswith(message)
        write(here / "bad" / "events.out.tfevents.1", "this is no event file at all")
        assert refusal("compare --csv bad").startswith(message)
        back = [event(5000, "return", 1.0), event(100, "return", 2.0)]
        write_events(here / "restarted" / "events.out.tfevents.1", back)
        message = (
            "restarted: return: steps go backwards, from 5,000 to 100; allowed: one run, whose steps ascend"
        )
        assert refusal("compare --csv restarted").startswith(message)

    def test_a_missing_package_is_named_with_the_command_that_installs_it(self, here, refusal, monkeypatch):
        from bojax.report.comparing.logs import event_files

        write(here / "board" / "events.out.tfevents.1", "")
        monkeypatch.setattr(event_files, "_MODULES", ("no_such_package.event_pb2",))
        message = (
            "tensorboardX is not installed; install it in a clone of bojax: pip install -e '.[tensorboard]'"
        )
        assert refusal("compare --csv board").startswith(message)
