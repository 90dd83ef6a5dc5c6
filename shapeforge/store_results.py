"""What the stages from the fit on have found, read from a project: the half of a project that no user edits."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from shapeforge.store_arrays import ProjectError, read_arrays, read_record, write_arrays, write_record


class Results:
    """Results of a project by stage and key: ``<stage>/<key>/<name>.zarr.zip``.

    A stage that is run again with other inputs writes into another folder, so the old results stay readable until the
    new ones are complete; then the old folder goes.
    """

    path: Path
    heeds_refine = True
    """Whether what ``refine`` made of fit and machine counts instead of them."""

    def stage_record(self, stage: str) -> dict[str, Any] | None:
        """The record of one stage, None when it was never run (see the project)."""
        raise NotImplementedError

    # -- files -----------------------------------------------------------------------------------------------------

    def result_folder(self, stage: str, key: str) -> Path:
        """Where a stage with this key keeps its results."""
        return self.path / stage / key

    def current_folder(self, stage: str) -> Path | None:
        """Folder of the last complete results of a stage, None before there are any."""
        record = self.stage_record(stage)
        folder = self.result_folder(stage, record["result"]) if record and record.get("result") else None
        return folder if folder is not None and folder.is_dir() else None

    def drop_results(self, stage: str, keep: str | None) -> None:
        """Delete the results of a stage, all but those of the key ``keep``."""
        folder = self.path / stage
        for old in folder.iterdir() if folder.is_dir() else ():
            if old.name != keep:
                shutil.rmtree(old, ignore_errors=True)

    def clear_result(self, stage: str, key: str) -> None:
        """Delete what an abandoned run left under this key."""
        shutil.rmtree(self.result_folder(stage, key), ignore_errors=True)

    def _read(self, stage: str, name: str) -> Any | None:
        folder = self.current_folder(stage)
        path = None if folder is None else folder / f"{name}.zarr.zip"
        if path is None or not path.is_file():
            return None
        with self._remedy(stage):
            return read_record(path)[0]

    @contextlib.contextmanager
    def _remedy(self, stage: str) -> Iterator[None]:
        """Errors in files of a stage's results name the command that makes them again."""
        try:
            yield
        except ProjectError as error:
            remedy = f"Delete it and make it again: shapeforge {stage} {self.path}"
            raise ProjectError(error.path, error.problem, remedy) from error

    # -- the fit ---------------------------------------------------------------------------------------------------

    @property
    def fit_stage(self) -> str:
        """Whose fit counts: "refine" when it came after the present fit, else "fit"."""
        if not self.heeds_refine:
            return "fit"
        refined, fit = self.stage_record("refine"), self.stage_record("fit")
        newer = refined and fit and refined.get("result") and refined.get("of") == fit.get("result")
        return "refine" if newer else "fit"

    @property
    def fit_id(self) -> str | None:
        """Which fit counts, as an id that changes with it; None before a fit."""
        record = self.stage_record(self.fit_stage) or {}
        return record.get("result")

    @property
    def machine_id(self) -> str | None:
        """Which machine counts, as an id that changes with it; None before ``learn``."""
        record = self.stage_record(self.machine_stage) or {}
        return record.get("result")

    def fit(self) -> Any | None:
        """The ``FitState`` of the last complete fit (beliefs of all shapes in memory), None before a fit."""
        return self._read(self.fit_stage, "fit")

    @property
    def fit_names(self) -> tuple[str, ...]:
        """Names of the shapes the fit is about, in its order (shapes imported later are not among them)."""
        folder = self.current_folder(self.fit_stage)
        if folder is None:
            return ()
        with self._remedy(self.fit_stage):
            return tuple(name for name, _ in _names_and_keys(folder / "names.zarr.zip"))

    @property
    def fitted_keys(self) -> dict[str, str]:
        """Keys of the shapes as the last complete ``fit`` read them, by name; empty before it."""
        folder = self.current_folder("fit")
        if folder is None:
            return {}
        with self._remedy("fit"):
            return dict(_names_and_keys(folder / "names.zarr.zip"))

    def _fitted(self, name: str) -> dict[str, Any] | None:
        folder = self.current_folder(self.fit_stage)
        path = None if folder is None else folder / "shapes" / f"{name}.zarr.zip"
        if path is None or not path.is_file():
            return None
        stamp = path.stat()
        with self._remedy(self.fit_stage):
            return _read_fitted(path, stamp.st_mtime_ns, stamp.st_size)

    def beliefs(self, name: str) -> Any | None:
        """The ``Beliefs`` about one shape, None when it was not fitted."""
        found = self._fitted(name)
        return None if found is None else found["beliefs"]

    def face_labels(self, name: str) -> Int[np.ndarray, " F"] | None:
        """The fitted part of every face record (n_faces,), None when the shape was not fitted."""
        found = self._fitted(name)
        return None if found is None else found["labels"]

    def face_probabilities(self, name: str) -> Float[np.ndarray, "F L"] | None:
        """Probability of every part at every face record (n_faces, L), None when the shape was not fitted."""
        found = self._fitted(name)
        return None if found is None else found["probabilities"]

    def positions(self, name: str) -> Float[np.ndarray, "K 3"] | None:
        """Surface point that corresponds to each top-level template point (K, 3): normal coordinates, NaN absent."""
        found = self._fitted(name)
        return None if found is None else found["positions"]

    def existence(self, name: str) -> np.ndarray | None:
        """Which top-level template points the shape has (K,) bool, None when it was not fitted."""
        found = self._fitted(name)
        return None if found is None else found["existence"]

    def part_counts(self, name: str) -> Any | None:
        """The ``PartCounts`` of one shape: components and copies of every part; None when it was not fitted."""
        found = self._fitted(name)
        return None if found is None else found.get("counts")

    def hierarchy(self) -> Any | None:
        """The ``Hierarchy`` of the last complete fit."""
        return self._read(self.fit_stage, "hierarchy")

    @property
    def part_of_point(self) -> Int[np.ndarray, " K"] | None:
        """Part index of every top-level template point (K,), None before a fit."""
        hierarchy = self.hierarchy()
        return None if hierarchy is None else hierarchy.top.label

    def rounds(self, name: str) -> list[Float[np.ndarray, "K 3"]]:
        """Deformed template points (K, 3) of a shape after every recorded round, float16; empty when not recorded."""
        names = self.fit_names
        if name not in names:
            return []
        t, found = names.index(name), []
        for path in self._round_files():
            arrays, _ = read_arrays(path)
            start, stop = np.concatenate([[0], np.cumsum(arrays["lengths"])])[t : t + 2]
            found.append(arrays["deformed"][start:stop])
        return found

    def _round_files(self) -> list[Path]:
        """Recorded rounds of the fit, and of what refined it."""
        folders = [self.current_folder(stage) for stage in dict.fromkeys(("fit", self.fit_stage))]
        return [path for folder in folders if folder for path in sorted((folder / "rounds").glob("*.zarr.zip"))]

    def round_figures(self) -> list[dict[str, Any]]:
        """Per recorded round: ``energy`` (nats a point), ``change``, ``sigma`` (L,) (diagonals), ``template`` (T,)."""
        found = []
        for path in self._round_files():
            arrays, _ = read_arrays(path)
            if "energy" in arrays:
                figures = {key: arrays[key] for key in ("sigma", "template")}
                found.append(figures | {key: float(arrays[key]) for key in ("energy", "change")})
        return found

    # -- the machine -----------------------------------------------------------------------------------------------

    @property
    def machine_stage(self) -> str:
        """Whose machine counts: "refine" when it came after the present machine, else "learn"."""
        if not self.heeds_refine:
            return "learn"
        refined, learnt = self.stage_record("refine"), self.stage_record("learn")
        newer = refined and learnt and refined.get("result") and refined.get("from") == learnt.get("result")
        return "refine" if newer else "learn"

    def machine(self) -> Any | None:
        """The learnt ``BetaShapeMachine``, None before ``learn``."""
        return self._read(self.machine_stage, "machine")

    def observations(self) -> Any | None:
        """The ``Observations`` the machine learned from, None before ``learn``."""
        return self._read(self.machine_stage, "observations")

    def mixture(self) -> Any | None:
        """The ``Mixture`` that new shapes are drawn from, None before ``learn``."""
        return self._read(self.machine_stage, "mixture")

    def directions(self) -> Any | None:
        """The ``Direction`` of every slider, None before ``learn``."""
        return self._read(self.machine_stage, "directions")

    def descriptors(self) -> tuple[tuple[str, ...], Float[np.ndarray, "T F"]] | None:
        """Names (T,) and learnt descriptors (T, F) of the shapes, None before ``learn``."""
        found = self._read(self.machine_stage, "descriptors")
        return None if found is None else (tuple(found["names"]), found["values"])

    def draws(self) -> dict[str, Any] | None:
        """What ``synthesize`` drew last: points, exists, names, files, measures; None before it."""
        return self._read("synthesize", "draws")


def write_names(path: Path, names: tuple[str, ...], **about: Any) -> None:
    """Write down which shapes results are about, and what else there is to say of what these came from."""
    write_record(path, {"names": names, **about})


def write_round(path: Path, state: Any) -> None:
    """Record a round: every shape's deformed template points in float16 (1e-3 diagonals or better), and its figures."""
    from shapeforge.deformation.exemplars import leading

    beliefs = [leading(tried).beliefs for tried in state.candidates]
    deformed = [np.asarray(belief.deformed, np.float16) for belief in beliefs]
    write_arrays(
        path,
        {
            "deformed": np.concatenate(deformed),
            "lengths": np.array([len(points) for points in deformed], np.int64),
            "template": np.array([belief.template for belief in beliefs], np.int64),
            "energy": np.array(state.energy, np.float64),
            "change": np.array(state.change, np.float64),
            "sigma": np.asarray(state.sigma_by_part, np.float64),
        },
    )


@lru_cache(maxsize=64)
def _read_fitted(path: Path, modified: int, size: int) -> dict[str, Any]:
    return read_record(path)[0]


@lru_cache(maxsize=8)
def _names_and_keys(path: Path) -> tuple[tuple[str, str], ...]:
    record = read_record(path)[0]
    keys = record.get("keys", {})
    return tuple((name, keys.get(name, "")) for name in record["names"])
