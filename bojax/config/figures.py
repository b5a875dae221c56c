"""The figures of a report: their names are known without importing what draws them."""

FIGURES = {
    "accumulated-reward": "curves",
    "success": "curves",
    "learning-curves": "curves",
    "success-episodes": "curves",
    "solved-episodes": "curves",
    "steps-to-goal": "curves",
    "value-maps": "value_maps",
    "growth": "sweeps",
    "sweep-curve": "sweeps",
    "returns": "returns",
    "errors": "errors",
    "errors-by-distance": "errors",
    "paths": "paths",
    "particles": "particles",
    "beliefs": "maps",
    "surfaces": "maps",
    "error-map": "maps",
    "trajectories": "paths",
    "settings": "grids",
    "heat-map": "grids",
}
"""The module of `bojax.report.figures` of every figure, in the order of a page that does not list figures."""

TABLES = ("latency",)
"""Names that `report.figures` may also hold: tables that are on every page."""
