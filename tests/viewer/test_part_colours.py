"""A part's own colour is the same in every place of the window, in the report and in meshes that are written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shapeforge.collection.colours import as_hex, part_colours
from shapeforge.collection.iterate import last
from shapeforge.stages import run
from shapeforge.store import Project
from shapeforge.viewer import likeness
from shapeforge.viewer.fit_record import FitRecord
from shapeforge.viewer.lightbox import Lightbox
from shapeforge.viewer.palette import rgb
from shapeforge.viewer.report import write_report
from shapeforge.viewer.sculptor import Sculptor
from shapeforge.viewer.session import Session
from tests.viewer.learned_family import learned_family

OWN = "#F21ADE"


@pytest.fixture
def coloured(fitted: Project) -> Project:
    names = fitted.part_names
    fitted.set_part_names(replace(names, colours={names.names[1]: OWN}))
    return fitted


def session_on(project: Project) -> Session:
    session = Session()
    session.open(project)
    return session


def test_it_is_that_of_the_fit_the_comparison_and_the_report(coloured, tmp_path):
    record = FitRecord(coloured)
    record.load()
    assert record.looks[0].inks[1].tolist() == list(rgb(OWN))
    box = Lightbox(session_on(coloured))
    box.reload()
    name = next(n for n in coloured.fit_names if (coloured.face_labels(n) == 1).any())
    view = box.display((name,), colour_by="part").views[0]
    assert (view.layers[0].colours == rgb(OWN)).all(axis=1).any()
    picture = likeness.part_picture(coloured, name, 96).astype(int)
    assert (np.abs(picture[..., :3] - rgb(OWN)).max(axis=-1) < 90)[picture[..., 3] > 200].any()
    page = write_report(coloured, tmp_path / "page.html").read_text()
    assert OWN.lower() in page.lower() and as_hex(part_colours(2)[1]).lower() not in page.lower()


def test_a_colour_changed_later_is_taken_up_without_a_new_fit(coloured):
    record = FitRecord(coloured)
    record.load()
    assert not record.recolour()
    coloured.set_part_names(replace(coloured.part_names, colours={}))
    assert record.recolour() and record.looks[0].inks[1].tolist() == part_colours(2)[1].tolist()
    assert coloured.stage_record("fit")["state"] == "done"


def test_made_meshes_carry_it(tmp_path_factory, tmp_path):
    project = learned_family(tmp_path_factory, "coloured")
    names = project.part_names
    project.set_part_names(replace(names, colours={names.names[0]: OWN}))
    last(run(project, "synthesize", count=1, out=str(tmp_path), format="ply", restart=True, jobs=1))
    made = next(tmp_path.glob("*.ply")).read_bytes()
    assert bytes(rgb(OWN)) in made
    sculptor = Sculptor(session_on(project))
    sculptor.reload()
    assert sculptor.inks[0].tolist() == list(rgb(OWN))
