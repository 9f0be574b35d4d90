"""One registry of results: how each type is described, drawn and written; and the ways to show it.

`Result` is what every public function returns a subclass of (`scene_results`,
`campaign_results`); `PRESENTERS` says of each subclass its ``kind``, the names that ``--json``
writes, and which functions of this room describe and draw it. These functions are imported when
they are used: what draws takes a quarter of a second, sentences on campaigns half of one.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import attributes, json_text, plain, write_text
from mcrim_mitsuba.output import description as showing
from mcrim_mitsuba.output.description import Description

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

    from mcrim_mitsuba.output.figure_style import Drawing

Document = dict[str, Any]

_PROVENANCE = (
    "seed=provenance.seed photons=provenance.photons cached_photons=provenance.cached_photons "
    "scene_hash=provenance.scene_hash versions=provenance.versions"
)
_DIAGNOSIS = (
    "verdict reason baseline candidates pairs leading leading_sets upper_limits suspect_readings "
    "repair next_measurements not_tried probabilities inclusion capability light_yield_averaged "
    "seconds=provenance.seconds families set_aside titles unsettled"
)
_CHECKED = (
    "parameters chi2 ndf p_value expected_chi2 rms_pull left_out_error rows left_out_pulls "
    "suspects trends absorbed **numbers"
)


@dataclass(frozen=True, kw_only=True)
class Presenter:
    """How results of one type are described, drawn and written; functions take the result."""

    #: What a document of it says that it is, and the version of its names.
    kind: str
    version: int = 1
    #: What ``--json`` writes, in this order, as `core.files.attributes` takes it.
    names: str
    #: Makes its `description.Description`.
    describe: Callable[[Any], Description]
    #: What draws it, by the name of the picture.
    figures: Mapping[str, Callable[[Any], Drawing]] = field(default_factory=dict)


class _Later:
    """A module of this room, imported when a function of it is called."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, function: str) -> Callable[..., Any]:
        module = f"mcrim_mitsuba.output.{self._name}"
        return lambda *given, **more: getattr(importlib.import_module(module), function)(
            *given, **more
        )


budget_figures = _Later("budget_figures")
cross_section = _Later("cross_section")
describe_campaign = _Later("describe_campaign")
describe_laboratory = _Later("describe_laboratory")
describe_scene = _Later("describe_scene")
diagnosis_figures = _Later("diagnosis_figures")
fit_figures = _Later("fit_figures")
laboratory_figures = _Later("laboratory_figures")
light_figures = _Later("light_figures")


PRESENTERS = {
    "LightResult": Presenter(
        kind="simulation",
        describe=describe_scene.of_simulation,
        figures={
            "arrival": lambda light: light_figures.draw_arrival(light.lights),
            "fates": lambda light: light_figures.draw_fates(light.lights),
        },
        names="eta eta_sigma **of_detectors photons cached_photons seed seconds photons_per_second "
        "budget budget_sigma parameters versions scene_hash polarization transport "
        "photons_requested=requested interrupted notes",
    ),
    "MapResult": Presenter(
        kind="map",
        describe=describe_scene.of_map,
        figures={"map": lambda eta_map: light_figures.draw_map(eta_map, eta_map.gamma_spreads)},
        names="spreads=gamma_spreads cells=eta.shape photons seed parameters scene_hash",
    ),
    "SpectrumResult": Presenter(
        kind="spectrum",
        describe=describe_scene.of_spectrum,
        figures={"spectrum": light_figures.draw_spectrum},
        names="eta_emitted eta_emitted_sigma eta_detected eta_detected_sigma efficiency_emitted "
        "efficiency_arriving efficiency_arriving_sigma eta_at_mean eta_at_mean_sigma "
        "one_wavelength_off one_wavelength_off_sigma interpolation_error nodes_nm photons "
        "cached_photons seed parameters scene_hash mean_wavelength_nm=light.mean_nm wavelengths",
    ),
    "TimesResult": Presenter(
        kind="times",
        describe=describe_scene.of_times,
        figures={"times": light_figures.draw_times},
        names="mean_ps mean_ps_sigma rms_ps rms_ps_sigma begin_ps begin_ps_sigma rise_ps "
        "rise_ps_sigma decay_ns detected first parts photons seed parameters scene_hash notes",
    ),
    "TableResult": Presenter(
        kind="table",
        describe=describe_scene.of_table,
        figures={"eta": light_figures.draw_table},
        names="rows **of_attenuation photons cached_photons seed seconds parameters scene_hash "
        "notes",
    ),
    "CheckResult": Presenter(
        kind="check",
        describe=describe_scene.of_check,
        figures={"cross_section": cross_section.draw_check},
        names="ok problems parameters interfaces words notes",
    ),
    "CrosscheckResult": Presenter(
        kind="crosscheck",
        describe=describe_scene.of_crosscheck,
        names="rows family_p_value agrees photons seed",
    ),
    "ReductionResult": Presenter(
        kind="reduction",
        describe=describe_laboratory.of_reduction,
        figures={
            kind: partial(laboratory_figures.draw_raw_data, kind=kind)
            for kind in ("histograms", "calibration", "spectra", "transmittance")
        },
        names="campaign=campaign_path **steps plain_campaign=plain_path",
    ),
    "FitResult": Presenter(
        kind="fit",
        describe=describe_campaign.of_fit,
        figures={
            "readings": lambda fit: fit_figures.draw_comparison(fit, unit=fit.unit),
            "profiles": lambda fit: fit_figures.draw_profiles(fit.profiles),
            "budget": budget_figures.draw_budget,
        },
        names="**numbers seconds photons=provenance.photons seed=provenance.seed "
        "scene_hash=provenance.scene_hash versions=provenance.versions",
    ),
    "ComparisonResult": Presenter(
        kind="comparison",
        describe=describe_campaign.of_comparison,
        figures={"readings": lambda fit: fit_figures.draw_comparison(fit, unit=fit.unit)},
        names=f"{_CHECKED} {_PROVENANCE} seconds=provenance.seconds",
    ),
    "HypothesesResult": Presenter(
        kind="hypotheses",
        describe=describe_campaign.of_hypotheses,
        figures={"pulls": fit_figures.draw_hypotheses},
        names="verdict reason leading hypotheses=hypotheses_with_scenes apart "
        f"{_PROVENANCE} scene_hash=scenes seconds=provenance.seconds notes",
    ),
    "DiagnosisResult": Presenter(
        kind="diagnosis",
        describe=describe_campaign.of_diagnosis,
        figures={"ranking": diagnosis_figures.draw_ranking, "next": diagnosis_figures.draw_next},
        names=f"{_DIAGNOSIS} {_PROVENANCE} notes",
    ),
    "RepairResult": Presenter(
        kind="repair",
        describe=describe_campaign.of_repair,
        figures={
            "staircase": lambda r: diagnosis_figures.draw_staircase(r.repair, r.mended_fit),
            "readings": lambda r: fit_figures.draw_comparison(
                r.baseline, r.mended_fit, added=r.added, unit=r.unit
            ),
        },
        names=f"{_DIAGNOSIS} effects calibration undetermined campaign=campaign_path "
        f"scene=scene_path {_PROVENANCE} notes",
    ),
    "ReportResult": Presenter(
        kind="report",
        describe=describe_campaign.of_report,
        names=f"{_DIAGNOSIS} **sections.numbers report=path {_PROVENANCE} notes",
    ),
    "BudgetResult": Presenter(
        kind="budget",
        describe=describe_campaign.of_budget,
        figures={"neglected": budget_figures.draw_neglected},
        names=f"**numbers {_PROVENANCE} seconds=provenance.seconds notes",
    ),
    "PlanResult": Presenter(
        kind="plan",
        describe=describe_campaign.of_plan,
        figures={"plan": budget_figures.draw_plan},
        names="**numbers",
    ),
}

#: What is written of what results hold, by type; of others all fields are.
_PARTS = {
    "Calibration": "**numbers",
    "VerbResult": "**numbers",
    "Comparison": _CHECKED,
    "ExpectedError": "statistical systematic total parts",
    "Spread": "source eta eta_sigma relative_rms relative_rms_sigma fwhm",
    "SceneProblem": "kind text mend file=path line column",
    "Interface": "surface kind interior exterior n_interior n_exterior file=path line",
}


def encoded(value: object) -> Any:
    """What ``--json`` writes of a value: results and what they hold by their `Presenter.names`.

    Other dataclasses are written with all fields, everything else as `core.files.plain` does.
    """
    if isinstance(value, Mapping):
        return {name: encoded(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [encoded(item) for item in value]
    name = type(value).__name__
    names = PRESENTERS[name].names if name in PRESENTERS else _PARTS.get(name)
    if names is None:
        names = " ".join(getattr(value, "__dataclass_fields__", ()))
    return encoded(attributes(value, names)) if names else value


def fields_of(value: Any) -> dict[str, Any]:
    """The fields of a dataclass by name, to make one of a type that has these and more."""
    return {part.name: getattr(value, part.name) for part in fields(value) if part.init}


class Result:
    """What a public function gives: numbers as fields, and every way to show them.

    ``print(result)`` shows what the command shows, a notebook the same as tables.
    """

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """A parameter of the scene, or a fitted one, by its name."""
            # not while it is copied or unpickled
            parameters = self.__dict__.get("parameters", {}) if name[0] != "_" else {}
            if name in parameters:
                return parameters[name]
            raise AttributeError(f"{type(self).__name__} has no {name}")

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.__dict__.get("parameters", {})})

    def __str__(self) -> str:
        return showing.text(self.description)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.description.title}; print it to read it>"

    def _repr_html_(self) -> str:
        from mcrim_mitsuba.output.pages import environment

        return environment().get_template("notebook.html").render(parts=self.description.whole)

    @property
    def description(self) -> Description:
        """How it is shown: tables, sentences, notes."""
        return self._presenter.describe(self)

    @property
    def document(self) -> Document:
        """As ``--json`` writes it."""
        presenter = self._presenter
        return {"kind": presenter.kind, "version": presenter.version, **encoded(self)}

    @property
    def pictures(self) -> tuple[str, ...]:
        """Names of its figures, the first of which `plot` draws."""
        return tuple(self._presenter.figures)

    @property
    def _presenter(self) -> Presenter:
        return PRESENTERS[type(self).__name__]

    def _drawing(self, picture: str) -> Drawing:
        """Under the title of a campaign; other results have none."""
        drawing = self._presenter.figures[picture](self)
        title = self.__dict__.get("title")
        return drawing.entitled(title) if title else drawing

    def to_json(self, path: str | Path | None = None) -> str:
        """The document of ``--json`` as text; written to a file too, if one is named."""
        text = json_text(self.document, indent=2)
        if path is not None:
            write_text(path, text + "\n")
        return text

    def to_dataframe(self, title: str | None = None) -> pandas.DataFrame:
        """A table of what is shown, with errors in columns of their own (``NAME_sigma``).

        It is that of this title, by default the first. Raises InputError if there is no such table.
        """
        tables = self.description.tables
        if not tables:
            raise InputError("nothing of this is a table", "print it")
        return tables[_chosen("table", title, tables, "{!r}")].frame()

    def to_xarray(self) -> xarray.Dataset:
        """As a dataset with units; its attributes say what makes it reproducible.

        Tables, maps, spectra and times lie over their axes, simulations, fits and diagnoses as
        converted files do; of other results it is `to_dataframe`.
        """
        from mcrim_mitsuba.output import codec

        over_axes = getattr(super(), "to_xarray", None)
        if over_axes is not None:
            data: xarray.Dataset = over_axes()
            return data
        document = plain(self.document)
        if document["kind"] not in codec.READERS:
            import xarray

            return xarray.Dataset.from_dataframe(self.to_dataframe())
        kind, part = codec.read_document(codec.JsonObject(document))
        return codec.dataset(codec.joined(kind, {self.description.title: part}))

    def plot(self, picture: str | None = None) -> Figure:
        """A figure of it, by matplotlib: the `picture` of this name, by default the first.

        Raises InputError if there is none of this name, or none at all.
        """
        if not self.pictures:
            raise InputError("there is no picture", "print it")
        return self._drawing(_chosen("picture", picture, self.pictures)).figure

    def draw(self, path: str | Path, *, replace: bool = False) -> tuple[Path, ...]:
        """Write all pictures (PNG or PDF) with their numbers (CSV): NAME, NAME_profiles, ...

        Raises InputError if a file cannot be written, or if numbers would replace a table that
        lies beside no picture of its name, unless that is to `replace`.
        """
        from mcrim_mitsuba.output import figure_style

        path = Path(path)
        endings = ["", *(f"_{name}" for name in self.pictures[1:])]
        files = [path.with_name(f"{path.stem}{ending}{path.suffix}") for ending in endings]
        for file in () if replace else files:
            figure_style.refuse_table_without_figure(figure_style.numbers_beside(file))
        pictures = zip(self.pictures, files, strict=False)
        return tuple(each for name, file in pictures for each in self._drawing(name).save(file))


def _chosen(what: str, name: str | None, names: Iterable[str], quoted: str = "{}") -> str:
    """The name that was asked for, or the first; refuses what is not there."""
    names = list(names)
    if name is not None and name not in names:
        mend = f"ask for one of {', '.join(map(quoted.format, names))}"
        raise InputError(f"there is no {what} {name!r}", mend)
    return names[0] if name is None else name


@dataclass(frozen=True, kw_only=True, repr=False)
class VerbResult(Result):
    """What a verb without a public function computed: it brings its description and document."""

    kind: str
    shown: Description
    numbers: Document
    drawings: Mapping[str, Callable[[], Drawing]] = field(default_factory=dict)

    @property
    def _presenter(self) -> Presenter:
        names = _PARTS["VerbResult"]
        figures = {name: lambda _, name=name: self.drawings[name]() for name in self.drawings}
        return Presenter(
            kind=self.kind, names=names, describe=lambda _: self.shown, figures=figures
        )
