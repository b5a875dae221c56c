from bojax.api.errors import BojaxError as BojaxError
from bojax.api.errors import Interrupted as Interrupted
from bojax.api.mission import Area as Area
from bojax.api.mission import Mission as Mission
from bojax.api.mission import Place as Place
from bojax.api.mission import read_place as read_place
from bojax.api.optimisation import OptimisationResult as OptimisationResult
from bojax.api.optimiser import ObjectiveError as ObjectiveError
from bojax.api.optimiser import Optimiser as Optimiser
from bojax.api.optimiser import maximise as maximise
from bojax.api.optimiser import minimise as minimise
from bojax.api.parts import part as part
from bojax.api.plots import plot_gp as plot_gp
from bojax.api.plots import plot_search as plot_search
from bojax.api.results import Picture as Picture
from bojax.api.results import Results as Results
from bojax.api.results import TuningResults as TuningResults
from bojax.api.results import load as load
from bojax.api.start import run as run
from bojax.api.start import sweep as sweep
from bojax.api.start import tune as tune
from bojax.api.surveying import SurveyResult as SurveyResult
from bojax.api.surveying import survey as survey

__version__: str
