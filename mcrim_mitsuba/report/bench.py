"""The bench for the report: what it is made of, its parameters, its cross-section and picture."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.figure import Figure

from mcrim_mitsuba.check.report import Interface
from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.measurements import Reading
from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.files.values import Value
from mcrim_mitsuba.recording import RunOptions
from mcrim_mitsuba.report import photographer

#: Size of the picture over that of `mcrim render`: enough for a printed page.
PICTURE_SCALE = 0.8


@dataclass(frozen=True)
class BenchParameter:
    """One parameter of the scene.

    Attributes
    ----------
    name : str
    value : float, int, bool or str
        As fitted, where it was.
    unit : str or None
    meaning : str
        The comment in the file, or empty.
    role : str
        ``fitted``, ``held``, ``differs from reading to reading`` or empty: the scene's value.
    """

    name: str
    value: Value
    unit: str | None
    meaning: str
    role: str


@dataclass(frozen=True, eq=False)
class Bench:
    """The bench that the result belongs to.

    Attributes
    ----------
    sentences : tuple of str
        What the scene means.
    faces : tuple of Interface
    parameters : tuple of BenchParameter
    cross_section : Figure
    reading : str
        Label of the reading whose configuration is drawn.
    photograph : Photograph
        Of this configuration.
    """

    sentences: tuple[str, ...]
    faces: tuple[Interface, ...]
    parameters: tuple[BenchParameter, ...]
    cross_section: Figure
    reading: str
    photograph: photographer.Photograph


def describe(campaign: Campaign, scene: SceneFile, reading: Reading, options: RunOptions) -> Bench:
    """Look at a scene.

    Parameters
    ----------
    campaign : Campaign
        With the effects that the result has.
    scene : SceneFile
        With these effects in it, at the fitted values.
    reading : Reading
        Whose configuration is drawn.
    options : RunOptions

    Raises
    ------
    InputError
        If the scene is not sound.
    """
    from mcrim_mitsuba.check.cross_section import cross_section_figure
    from mcrim_mitsuba.check.scene import check_simulation
    from mcrim_mitsuba.kernel.simulation import Simulation

    drawn = scene.with_overrides(reading.parameters)
    simulation = Simulation(drawn, variant=options.variant, threads=options.threads, check=False)
    report = check_simulation(simulation, light=False)
    if report.problems:
        raise report.problems[0].error()
    # drawn in another process while what follows is made
    photograph = photographer.photograph(drawn, options, PICTURE_SCALE)
    return Bench(
        sentences=report.words,
        faces=report.interfaces,
        parameters=tuple(_parameter(campaign, scene, name) for name in scene.parameters),
        cross_section=cross_section_figure(simulation, report.interfaces),
        reading=reading.label,
        photograph=photograph,
    )


def _parameter(campaign: Campaign, scene: SceneFile, name: str) -> BenchParameter:
    role = ""
    if name in campaign.parameters:
        role = "held" if campaign.parameters[name].fixed else "fitted"
    elif name in campaign.measurements.columns:
        role = "differs from reading to reading"
    written = scene.defaults[name]
    return BenchParameter(name, scene.parameters[name], written.unit, written.comment, role)
