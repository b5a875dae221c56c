"""Chooses the film of a results folder."""

from collections.abc import Callable
from pathlib import Path

from bojax.envs.settings import Gymnasium
from bojax.experiments.settings import Planning
from bojax.films.beliefs import BeliefFilm
from bojax.films.film import Film
from bojax.films.learning import LearningFilm
from bojax.films.planning import PlanningFilm
from bojax.films.recorded import Episode, choose_drive, choose_episode, choose_trace, has_traces
from bojax.films.scenes import Replay
from bojax.problems.pomdp.settings import StateProblemSettings
from bojax.report.manifest import Unread
from bojax.report.source import Results
from bojax.results.store import ResultsError


def choose_film(
    results: Results,
    point: int | None = None,
    run: int | None = None,
    episode: int | None = None,
    model: Path | None = None,
    replay: Callable[[Episode], Replay] | None = None,
) -> Film:
    """A film of a recorded run, drawn with the robot of its settings, or with the robot of an MJCF file.

    The point and the run are given by index; by default they are the first recorded ones. The default episode
    of a learning run is its first success, else its last episode. `replay` steps an episode of a Gymnasium
    environment again, which draws itself.
    """
    if results.points[0].is_learning:
        chosen = choose_episode(results, point, run, episode)
        draws_itself = replay is not None and model is None and isinstance(chosen.point.env, Gymnasium)
        return LearningFilm(chosen, model, replay(chosen) if replay and draws_itself else None)
    experiment = results.points[0].experiment
    if isinstance(experiment, Unread):
        raise ResultsError(f"{results.folder}: this version cannot read the settings: {experiment.reason}")
    if not isinstance(experiment, Planning):
        raise ResultsError(
            f"{results.folder}: got results of {experiment.kind}; only planners and learners can be animated"
        )
    if episode is not None:
        raise ResultsError("--episode: a run of a planner is one episode")
    if isinstance(experiment.problem, StateProblemSettings) or has_traces(results):
        if model is not None:
            raise ResultsError("--model: a state problem has no robot of MuJoCo to draw")
        return BeliefFilm(choose_trace(results, point, run))
    return PlanningFilm(choose_drive(results, point, run), model)
