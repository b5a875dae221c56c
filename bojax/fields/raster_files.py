"""Readers of rasters: GeoTIFF, NetCDF, ESRI ASCII, XYZ, NumPy files and tables of numbers."""

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bojax.config.extras import needed
from bojax.config.limits import NUMBERS, TEXT, read_within
from bojax.fields.data import X_NAMES, Y_NAMES, Points, in_file, read_array, read_points, split_choice
from bojax.fields.projection import Projection
from bojax.fields.raster import DEGREES, Raster, regular, thinning

if TYPE_CHECKING:
    import numpy as np

_NETCDF = (".nc", ".nc4")
_WITH_RASTERIO = (".tif", ".tiff", *_NETCDF)
_TABLES = (".npy", ".csv")
_GRIDS = (".asc", ".npz", ".xyz")
SUFFIXES = (*_TABLES, *_GRIDS, *_WITH_RASTERIO)
"""Endings of the names of files that hold rasters."""

FORMATS = ".npy, .npz, .csv, .xyz, .asc (ESRI ASCII), and with the extra `geo` .tif and .nc"

UNSIZED = (
    "it has no positions of rows and columns (arrays x and y of a .npz file): cells are taken to be 1 m wide."
)
"""The note on a raster without them."""


def read_raster(file: str, most: int | None = None) -> Raster:
    """The raster in a file, thinned to at most `most` cells, by default as many as the memory allows.

    A NetCDF file with several variables needs the name of one: `FILE.nc:NAME`. A file with several bands,
    such as times, needs the number of one, from 1: `FILE.nc:NAME:3`, or `FILE.tif::3`, which has no names.

    Raises:
        ValueError: The file cannot be read, or holds no raster; see `in_file`.
        MissingExtra: The format needs the extra `geo`.
    """
    most = NUMBERS.allowed if most is None else most
    path, chosen = split_choice(file)
    suffix = Path(path).suffix.lower()
    with in_file(file):
        if suffix not in SUFFIXES:
            raise ValueError(f"{file}: the name has to end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
        if suffix in _WITH_RASTERIO:
            return _read_with_rasterio(path, chosen, most)
        if chosen:
            raise ValueError(f"{path}: got {chosen}, but a grid is read as a whole; allowed: {path}")
        return _read_plain(file, suffix).thinned(most)


def local_extent(raster: Raster) -> tuple[float, float, float, float]:
    """The extent of a raster in metres, `(x_min, y_min, x_max, y_max)`."""
    import numpy as np

    corners = np.array(raster.extent).reshape(2, 2)
    x_min, y_min, x_max, y_max = Projection.of(raster.crs, raster.extent).to_local(corners).ravel()
    return float(x_min), float(y_min), float(x_max), float(y_max)


def frame_of(file: str) -> Projection:
    """The frame in metres that the fields `grid` and `scattered` read a file in."""
    try:
        points = read_points(file)
    except ValueError:
        raster = read_raster(file)
        return Projection.of(raster.crs, raster.extent, file)
    return _points_frame(points, file)


def read_local_points(file: str) -> "np.ndarray":
    """Rows of x, y and value in a file, in metres; longitudes and latitudes are projected."""
    points = read_points(file)
    points.rows[:, :2] = _points_frame(points, file).to_local(points.rows[:, :2])
    return points.rows


def _points_frame(points: Points, file: str) -> Projection:
    (x_min, y_min), (x_max, y_max) = points.rows[:, :2].min(0), points.rows[:, :2].max(0)
    return Projection.of(points.crs, (float(x_min), float(y_min), float(x_max), float(y_max)), file)


def _read_plain(file: str, suffix: str) -> Raster:
    import numpy as np

    if suffix == ".asc":
        return _read_ascii(file)
    if suffix == ".npz":
        return _read_archive(file)
    if suffix == ".xyz":
        return _pivoted(read_points(file), file)
    table = read_array(file, allows_holes=True)
    raster = regular(table, np.arange(table.shape[1]), np.arange(table.shape[0]), None, file)
    return replace(raster, notes=(UNSIZED,))


def _read_ascii(file: str) -> Raster:
    """A raster of ESRI, whose first row is the northernmost; the projection is that of a `.prj` file."""
    import numpy as np

    lines = read_within(TEXT, Path(file), file).decode("utf-8-sig").splitlines()
    header: dict[str, float] = {}
    while lines and lines[0].split()[:1] and lines[0].split()[0][0].isalpha():
        key, value = (lines.pop(0).split() + [""])[:2]
        header[key.lower()] = float(value)
    if lacking := {"ncols", "nrows", "cellsize"} - header.keys():
        raise ValueError(f"the header lacks {', '.join(sorted(lacking))}")
    width, height, size = int(header["ncols"]), int(header["nrows"]), header["cellsize"]
    numbers = np.array(" ".join(lines).split(), float)
    if numbers.size != width * height or not size > 0:
        raise ValueError(f"got {numbers.size} numbers; the header asks for {height} x {width}")
    values = np.where(numbers == header.get("nodata_value", -9999.0), np.nan, numbers).reshape(height, width)
    west, south = (
        header[f"{axis}llcenter"] if f"{axis}llcenter" in header else header[f"{axis}llcorner"] + size / 2
        for axis in "xy"
    )
    x, y = west + size * np.arange(width), south + size * np.arange(height)
    return regular(values, x, y[::-1], _crs_beside(file, x, y), file)


def _crs_beside(file: str, x: "np.ndarray", y: "np.ndarray") -> str | None:
    """The projection in the `.prj` file beside a raster; without one, degrees if all positions can be."""
    beside = Path(file).with_suffix(".prj")
    if beside.is_file():
        return read_within(TEXT, beside, str(beside)).decode().strip()
    return DEGREES if _are_degrees(x, y) else None


def _are_degrees(x: "np.ndarray", y: "np.ndarray") -> bool:
    """Whether positions without a unit are degrees: in their range, and closer than a hundredth."""
    return bool(abs(x).max() <= 360 and abs(y).max() <= 90 and abs(x[1] - x[0]) < 0.01)


def _read_archive(file: str) -> Raster:
    import numpy as np

    with np.load(file, allow_pickle=False) as archive:
        arrays: dict[str, Any] = {name.lower(): archive[name] for name in archive.files}
    tables = {name: array for name, array in arrays.items() if array.ndim == 2 and array.dtype.kind in "iuf"}
    masks = [array for array in arrays.values() if array.ndim == 2 and array.dtype == bool]
    if len(tables) != 1:
        raise ValueError(f"holds {len(tables)} tables of numbers; allowed: one, with a mask if need be")
    ((name, table),) = tables.items()
    values = np.array(table, float)
    NUMBERS.check(values.size, file)
    for mask in masks:
        if mask.shape == values.shape:  # as in numpy.ma: true where there is no data
            values = np.where(mask, np.nan, values)
    x, x_name = _axis_of(arrays, X_NAMES, values.shape[1])
    y, y_name = _axis_of(arrays, Y_NAMES, values.shape[0])
    is_geographic = x_name.startswith("lon") and y_name.startswith("lat")
    raster = regular(values, x, y, DEGREES if is_geographic or _are_degrees(x, y) else None, file)
    is_named = name != "arr_0"  # the name that NumPy gives to an array without one
    raster = replace(raster, label=name if is_named else "")
    return raster if x_name and y_name else replace(raster, notes=(UNSIZED,))


def _axis_of(arrays: dict[str, Any], names: tuple[str, ...], size: int) -> "tuple[np.ndarray, str]":
    """Positions along an axis: an array of a known name, equal steps between two ends, or the indices."""
    import numpy as np

    for name in names:
        if name in arrays and arrays[name].ndim == 1:
            if len(arrays[name]) != size:
                each = "column" if names is X_NAMES else "row"
                got = f"{name}: got {len(arrays[name])} positions"
                raise ValueError(f"{got}; allowed: {size}, one for each {each}")
            return np.asarray(arrays[name], float), name
    low, high = (arrays.get(f"{names[0]}{end}") for end in ("min", "max"))
    if low is not None and high is not None and low.size == high.size == 1:
        return np.linspace(low.item(), high.item(), size), names[0]
    return np.arange(size, dtype=float), ""


def _pivoted(points: Points, file: str) -> Raster:
    """A raster from rows of x, y and value of its cells, in any order; absent cells are holes."""
    import numpy as np

    rows = points.rows
    x, y = np.unique(rows[:, 0]), np.unique(rows[:, 1])
    if len(x) * len(y) > 4 * len(rows):
        raise ValueError("the points are not on a regular grid; allowed for points: the field scattered")
    values = np.full((len(y), len(x)), np.nan)
    values[np.searchsorted(y, rows[:, 1]), np.searchsorted(x, rows[:, 0])] = rows[:, 2]
    return replace(regular(values, x, y, points.crs, file), label=points.label)


def _read_with_rasterio(path: str, chosen: str, most: int) -> Raster:
    with needed("rasterio", "geo"):
        import rasterio
    import warnings

    if not os.path.exists(path):
        raise ValueError(f"{path}: No such file or directory")
    variable, _, band = chosen.partition(":")
    name = f'netcdf:"{path}":{variable}' if variable else path
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a file without a place on the Earth
        if variable and Path(path).suffix.lower() not in _NETCDF:
            raise ValueError(f"{path}: got {chosen}; allowed: {path}::BAND")
        try:
            opened = rasterio.open(name)
        except OSError:
            with rasterio.open(path) as data:
                allowed = ", ".join(_variables(data)) or "none"
            raise ValueError(f"{path}: got variable {variable}; allowed: {allowed}") from None
        with opened as data:
            if data.count == 0 and data.subdatasets:
                allowed = f"{path}:NAME with one of {', '.join(_variables(data))}"
                raise ValueError(f"{path}: holds several variables; allowed: {allowed}")
            bands = [str(number + 1) for number in range(data.count)]
            if band and band not in bands:
                raise ValueError(f"{path}: got band {band}; allowed: 1 to {data.count}")
            if not band and len(bands) != 1:
                allowed = f"{path}:{variable}:BAND with one of 1 to {data.count}"
                raise ValueError(f"{path}: has {data.count} bands; allowed: {allowed}")
            return _from_rasterio(data, int(band or 1), path, most)


def _variables(data: Any) -> list[str]:
    """Names of the variables of a NetCDF file."""
    if data.subdatasets:
        return [each.rpartition(":")[2] for each in data.subdatasets]
    name = data.tags(1).get("NETCDF_VARNAME") if data.count else None
    return [name] if name else []


def _from_rasterio(data: Any, band: int, path: str, most: int) -> Raster:
    import numpy as np
    from rasterio.enums import Resampling

    transform = data.transform
    if transform.b or transform.d:
        raise ValueError(f"{path}: is rotated; allowed: rows along x (gdalwarp writes such a file)")
    step = thinning(data.shape, most)
    shape = tuple(max(2, size // step) for size in data.shape)
    masked = data.read(band, masked=True, out_shape=shape, resampling=Resampling.nearest)
    values = np.ma.filled(masked.astype(float) * data.scales[band - 1] + data.offsets[band - 1], np.nan)
    x = transform.c + transform.a * (np.arange(shape[1]) + 0.5) * data.width / shape[1]
    y = transform.f + transform.e * (np.arange(shape[0]) + 0.5) * data.height / shape[0]
    crs = data.crs.to_string() if data.crs else None
    if data.crs and data.crs.is_geographic:
        crs = DEGREES
    elif crs is None and _has_degrees(data, x, y):
        crs = DEGREES
    return replace(regular(values, x, y, crs, path), step=step, label=_label(data, band))


def _label(data: Any, band: int) -> str:
    """Name and unit of the values of a band; empty if it has no name and no unit."""
    tags = data.tags(band)
    name = tags.get("NETCDF_VARNAME") or data.descriptions[band - 1] or ""
    unit = data.units[band - 1] or tags.get("units") or "1"
    return name if unit == "1" else f"{name or 'value'} ({unit})"


def _has_degrees(data: Any, x: "np.ndarray", y: "np.ndarray") -> bool:
    """Whether a file without a projection says in its tags, or by its positions, that they are degrees."""
    units = [str(value) for key, value in data.tags().items() if key.lower().endswith("#units")]
    return any(unit.startswith("degree") for unit in units) or _are_degrees(x, y)
