"""Plugins through which light goes its way: medium bulk, emitters, integrator, and its sensor."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import drjit as dr
import mitsuba as mi

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALL_DETECTORS, ALPHA_SCAT, COEFFICIENTS, MM_PER_CM
from mcrim_mitsuba.optics.emission_band import USUAL_NM, USUAL_WIDTH_NM, WIDTHS
from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.transport.bulk import CollimatedBeam, CrystalVolume, read_crystal
from mcrim_mitsuba.transport.collection import Launcher, collect, slope_along
from mcrim_mitsuba.transport.conversion import read_scene_model
from mcrim_mitsuba.transport.launch_plan import FateTally
from mcrim_mitsuba.transport.plugins import BEAM_AXES, beam_axis, described, number, sizes

#: That ``mitsuba.render`` follows where nobody says how many.
PHOTONS = 1_000_000


class BulkMedium(mi.Medium):
    """Homogeneous volume that scatters and absorbs; scenes are in millimetres.

    XML: ``<medium type="bulk" id="crystal">`` with

    ``alpha_scat_per_cm`` : float, default 0
        Scattering coefficient.
    ``alpha_abs_per_cm`` : float, default 0
        Absorption coefficient.
    ``scattering_gradient`` : float q, default 0
        The scattering coefficient is alpha_scat (1 + q u), where u runs from -1 at the bottom of
        the volume to 1 at its top (z extent of the shapes that border it). Only the transport
        knows that extent; for pictures scattering is even.
    ``scattering_exponent`` : float p from 0 to 4, default 0
        Of light that is born in it the scattering coefficient is alpha_scat times
        (wavelength_nm / wavelength)^p.
    ``wavelength_nm``, ``bandwidth_nm`` : float, default 540 and 150
        Maximum and full width at half maximum of this light's Gaussian band, cut off at 1.5 widths.
        Only the transport draws wavelengths; for pictures they are all alike.
    ``index`` : float, optional
        Index of refraction of what may fill the volume; where it is that of air (up to
        1.0005) nothing does, and the volume neither scatters nor absorbs.
    ``endless`` : boolean, default false
        A clear liquid without end, which light enters through faces that name it as exterior and
        which is nowhere else: there light goes on as it would in the air outside, but what it
        meets borders the liquid, and what that sends back is lost.
    nested ``phase``
        Phase function of the scattering, ``isotropic``, ``hg`` or ``rayleigh``; isotropic when
        absent.

    The coefficients are differentiable parameters of ``mitsuba.traverse``, in double precision.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        given = [float(props.get(name, 0.0)) for name in COEFFICIENTS]
        self.scattering_gradient = number(props, "scattering_gradient", 0.0, low=-1.0)
        self.scattering_exponent = number(props, "scattering_exponent", 0.0, high=4.0)
        wavelength = number(props, "wavelength_nm", USUAL_NM, low=100.0, high=1e4)
        # no wavelength of the band is 0
        widest = 0.99 * wavelength / WIDTHS if self.scattering_exponent else math.inf
        width = number(props, "bandwidth_nm", USUAL_WIDTH_NM, high=widest)
        self.relative_bandwidth = width / wavelength
        self.endless = bool(props.get("endless", False))
        if self.endless and any(given):
            problem = "an endless medium neither scatters nor absorbs: take its numbers away"
            raise ValueError(problem)
        if "index" in props and not is_filled(float(props["index"])):
            given = [0.0, 0.0]
        self.alpha_scat_per_cm, self.alpha_abs_per_cm = map(mi.Float64, given)
        self.m_is_homogeneous = True
        self.m_has_spectral_extinction = False

    def intersect_aabb(self, ray):
        return mi.Mask(True), mi.Float(0.0), mi.Float(mi.math.RayEpsilon)

    def get_majorant(self, mei, active=True):
        extinction = self.alpha_scat_per_cm + self.alpha_abs_per_cm
        return mi.UnpolarizedSpectrum(mi.Float(extinction / MM_PER_CM))

    def get_scattering_coefficients(self, mei, active=True):
        scattering = mi.UnpolarizedSpectrum(mi.Float(self.alpha_scat_per_cm / MM_PER_CM))
        return scattering, mi.UnpolarizedSpectrum(0.0), self.get_majorant(mei, active)

    def traverse(self, callback) -> None:
        for name in COEFFICIENTS:
            callback.put(name, getattr(self, name), mi.ParamFlags.Differentiable)
        for name in ("scattering_gradient", "scattering_exponent", "relative_bandwidth"):
            callback.put(name, getattr(self, name), mi.ParamFlags.NonDifferentiable)

    def to_string(self) -> str:
        return (
            f"BulkMedium[alpha_scat = {self.alpha_scat_per_cm[0]} /cm, "
            f"alpha_abs = {self.alpha_abs_per_cm[0]} /cm]"
        )


mi.register_medium("bulk", BulkMedium)


#: Of a slab in which light is born: below this, places in it are not told apart.
SLIMMEST_MM = 1e-3


class ScintillationEmitter(mi.Emitter):
    """Isotropic, unpolarised emission, uniform in the volume of the crystal or near a face.

    XML: ``<emitter type="scintillation"><ref id="crystal"/></emitter>``, where the
    reference names the crystal's medium. Its volume is what the shapes that border this
    medium enclose; nothing about its form or place is written here. It may have

    ``source_depth_mm`` : float, default infinite
        Emission falls with the depth below the top of the crystal, as exp(-depth / this).
    ``side_depth_mm`` : float, default infinite
        The same from the side of the lowest x; not beside ``source_depth_mm``.
    ``source_width_mm`` : float, default infinite
        Light is born in a slab alone, so thick along z, as of collimated gammas from the side: in
        what of it lies in the crystal. Not beside ``source_depth_mm``.
    ``source_z_mm`` : float
        Height of the middle of that slab above the bottom of the crystal.
    ``source_across_mm`` : float, default infinite
        Light is born in an upright square column alone, so wide, about the axis of the crystal, as
        of a beam of gammas from above. Not beside ``side_depth_mm``.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        media = [props[key] for key in props.keys() if isinstance(props[key], mi.Medium)]
        if len(media) != 1:
            raise ValueError(
                'a scintillation emitter names one medium, the crystal: write <ref id="crystal"/>'
            )
        self.medium = media[0]
        for name in ("source_depth_mm", "side_depth_mm"):
            depth_mm = float(props.get(name, float("inf")))
            if not depth_mm > 0.0:
                raise ValueError(f"{name} is {depth_mm:g}; give a positive number")
            setattr(self, name, depth_mm)
        if max(self.source_depth_mm, self.side_depth_mm) < float("inf"):
            raise ValueError("light is born near the top or near a side; give one depth")
        self.source_width_mm = number(props, "source_width_mm", math.inf, SLIMMEST_MM, math.inf)
        if self.source_width_mm < math.inf and "source_z_mm" not in props:
            raise ValueError("source_width_mm without source_z_mm; give the middle of the slab")
        if self.source_width_mm == math.inf and "source_z_mm" in props:
            raise ValueError("source_z_mm without source_width_mm; give the slab's thickness")
        self.source_z_mm = float(props.get("source_z_mm", 0.0))
        self.source_across_mm = number(props, "source_across_mm", math.inf, SLIMMEST_MM, math.inf)
        self.m_flags = +mi.EmitterFlags.Empty
        self.m_needs_sample_2 = True
        self.m_needs_sample_3 = True
        self._crystal: CrystalVolume | None = None

    def volume(self, model) -> CrystalVolume:
        """The crystal's volume in a scene (`transport.scene_model.SceneModel`).

        The emitter does not keep it: it holds the scene, and the scene holds this emitter through
        C++, where Python's garbage collector cannot see a cycle.
        """
        number = model.volume_index(self.medium)
        depths = self.source_depth_mm, self.side_depth_mm
        slab = self.source_z_mm, self.source_width_mm
        return CrystalVolume(model, number, *depths, slab, self.source_across_mm)

    def _among_all_shapes(self) -> CrystalVolume:
        """The crystal's volume, from those of all living shapes that border the medium.

        Mitsuba does not tell Python's emitters their scene. Dr.Jit has a list of the shapes, which
        a call to one that is not known before compiles code for.
        """
        faces: dict[str, mi.Shape] = {}

        def meet(shape):
            if self.medium in (shape.interior_medium(), shape.exterior_medium()):
                faces[shape.id() or f"face_{len(faces)}"] = shape
            return mi.Float(0.0)

        dr.dispatch(dr.reinterpret_array(mi.ShapePtr, dr.opaque(mi.UInt32, 0)), meet)
        around = mi.load_dict({"type": "scene"} | faces, parallel=False, optimize=False)
        return self.volume(read_scene_model(around))

    def sample_ray(self, time, sample1, sample2, sample3, active=True):
        """A photon's birth as a ray; its weight is 1 whatever the wavelength.

        `sample1` gives the third coordinate that `sample2` lacks: light is monochromatic here.

        Raises InputError if the crystal cannot be lit so. Where Dr.Jit records calls it asks every
        living emitter, those of other scenes too: there such an emitter's rays are not a number.
        """
        # This thread may be recording a call to the emitter, and can read nothing from shapes then.
        # The crystal is kept while its rays are used; of its shapes none holds this emitter.
        try:
            with ThreadPoolExecutor(1) as apart:
                self._crystal = apart.submit(self._among_all_shapes).result()
        except InputError:
            if not dr.flag(dr.JitFlag.SymbolicScope):
                raise
            return dr.full(mi.Ray3f, math.nan), mi.Spectrum(math.nan)
        ray = dr.zeros(mi.Ray3f)
        ray.o = self._crystal.born_from(mi.Float(sample1), sample2.x, sample2.y)
        ray.d = mi.warp.square_to_uniform_sphere(sample3)
        if self._crystal.aim is not None:
            ray.d = mi.Vector3f(self._crystal.aim)
        ray.maxt, ray.time = dr.inf, time
        return ray, mi.Spectrum(1.0)

    def sample_direction(self, it, sample, active=True):
        return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0.0)

    def pdf_direction(self, it, ds, active=True):
        return mi.Float(0.0)

    def eval(self, si, active=True):
        return mi.Spectrum(0.0)

    def bbox(self):
        return mi.ScalarBoundingBox3f()

    traverse, to_string = described(
        "source_depth_mm side_depth_mm source_z_mm source_width_mm source_across_mm"
    )


mi.register_emitter("scintillation", ScintillationEmitter)


class CollimatedBeamEmitter(ScintillationEmitter):
    """The beam of a spectrophotometer: parallel light through the middle of the crystal.

    XML: ``<emitter type="collimated_beam"><ref id="crystal"/> ...</emitter>``, where the reference
    names the crystal's medium, with

    ``diameter`` : float
        Of the beam, in the scene's millimetres; evenly lit.
    ``axis`` : string, default ``x``
        ``x``, ``y`` or ``z``: the beam flies along this axis, towards higher values.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.axis = beam_axis(props)
        (self.diameter_mm,) = sizes(props, "diameter")

    def volume(self, model) -> CrystalVolume:
        """See `ScintillationEmitter.volume`."""
        number, axis = model.volume_index(self.medium), BEAM_AXES.index(self.axis)
        return CollimatedBeam(model, number, axis, self.diameter_mm)

    traverse, to_string = described("axis diameter_mm")


mi.register_emitter("collimated_beam", CollimatedBeamEmitter)


#: Free flights after which photons are given up in crystals that scatter.
MAX_DEPTH_SCATTERING = 200_000
#: The same in clear crystals.
MAX_DEPTH_CLEAR = 2_000


class LightCollectionIntegrator(mi.CppADIntegrator):
    """Traces scintillation photons forward, from the crystal to their fate.

    XML: ``<integrator type="light_collection">`` with

    ``max_depth`` : integer, optional
        Free flights after which a photon is given up; what that cuts off is counted as
        ``truncated`` and reported. Without it, 200,000 where the crystal scatters, so that all
        light comes out, and 2,000 where it does not: light that is trapped there stays.
    ``polarization`` : boolean, default false
        Whether Fresnel reflection follows each photon's polarisation.
    ``detector`` : string, default ``all``
        The id of the detector whose light alone is eta, where there are several.

    Attributes
    ----------
    tally : FateTally or None
        Of the last `render`: eta with its standard error, and what became of the light.
    slopes : dict of str to tuple of float
        Of the last derivatives: by the name of a coefficient, that of eta (cm) and its
        standard error.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_depth = int(props["max_depth"]) if "max_depth" in props else None
        self.polarization = bool(props.get("polarization", False))
        self.detector = str(props.get("detector", ALL_DETECTORS))
        if self.max_depth is not None and self.max_depth < 1:
            raise ValueError(f"max_depth is {self.max_depth}; give at least 1")
        self.tally: FateTally | None = None
        self.slopes: dict[str, tuple[float, float]] = {}

    def depth_limit(self, scatters: bool) -> int:
        """Free flights after which a photon is given up, in a crystal that scatters or not."""
        if self.max_depth is not None:
            return self.max_depth
        return MAX_DEPTH_SCATTERING if scatters else MAX_DEPTH_CLEAR

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Mitsuba's entrance: the light collection efficiency as a tensor of shape (1, 1, 1).

        ``spp`` is the number of photons; 0 stands for what the sensor's sampler says, and for a
        million where the scene has no sensor. What the sensor's film shows does not matter.
        """
        launcher, plan = self._planned(scene, sensor, seed, spp)
        collect(launcher, **plan)
        self.tally = launcher.tally
        return mi.TensorXf([self.tally.eta], (1, 1, 1))

    def render_forward(self, scene, params, sensor=0, seed=0, spp=0):
        """Change of the efficiency, shape (1, 1, 1), along the coefficients' gradients.

        Raises InputError for gradients of parameters that eta has no derivative by here.
        """
        slopes = self._differentiate(scene, params, sensor, seed, spp)
        change = sum(slope * float(dr.grad(params[name])[0]) for name, slope in slopes.items())
        return mi.TensorXf([change], (1, 1, 1))

    def render_backward(self, scene, params, grad_in, sensor=0, seed=0, spp=0):
        """Add to the coefficients' gradients what `grad_in`, shape (1, 1, 1), makes of them.

        Raises InputError as `render_forward`.
        """
        for name, slope in self._differentiate(scene, params, sensor, seed, spp).items():
            dr.accum_grad(params[name], mi.Float64(slope * float(grad_in.array[0])))

    def _planned(self, scene, sensor, seed, spp):
        """What launches photons, and which ones it shall, as keyword arguments."""
        crystal = read_crystal(scene)
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor] if scene.sensors() else None
        photons = spp or (sensor.sampler().sample_count() if sensor else PHOTONS)
        plan = {"photons": photons, "seed": int(mi.UInt32(seed)[0])}
        plan["max_depth"] = self.depth_limit(crystal.scatters)
        return Launcher(crystal, self.polarization), plan

    def _differentiate(self, scene, params, sensor, seed, spp) -> dict[str, float]:
        """Derivatives of eta (cm) by the parameters whose gradients are on."""
        launcher, plan = self._planned(scene, sensor, seed, spp)
        volumes, self.slopes = launcher.path.model.volumes, {}
        for name, value in params.items():
            if not dr.grad_enabled(value):
                continue
            medium, coefficient = params.properties[name][2], name.rpartition(".")[2]
            if not isinstance(medium, BulkMedium):
                problem = f"there is no derivative of eta by {name}"
                mend = f"enable gradients of {' and '.join(COEFFICIENTS)} only"
                raise InputError(problem, mend)
            volume = launcher.path.model.volume_index(medium)
            if coefficient == ALPHA_SCAT and not volumes[volume].alpha_scat_per_mm:
                problem = f"{name} is 0, and light that does not scatter tells no derivative by it"
                raise InputError(problem, "give it a value above 0")
            along = [float(coefficient == name) / MM_PER_CM for name in COEFFICIENTS]
            self.slopes[name] = slope_along(launcher, tangent={volume: along}, **plan)
        return {name: slope for name, (slope, _) in self.slopes.items()}

    def aov_names(self) -> list[str]:
        return []

    traverse, to_string = described("max_depth polarization detector")


mi.register_integrator("light_collection", LightCollectionIntegrator)


class LightMeter(mi.Sensor):
    """What Mitsuba wants in a scene that it renders: one pixel, which shows the efficiency.

    XML: ``<sensor type="light_meter"/>``; it may have

    ``photons`` : integer, default 1,000,000
        How many to follow where ``spp`` does not say it.

    Light is detected by the shapes that wear a photodetector; this has no place in the scene.
    """

    def __init__(self, props: mi.Properties) -> None:
        photons = int(props.get("photons", PHOTONS))
        if photons < 1:
            raise ValueError(f"photons is {photons}; give at least 1")
        film = {"type": "hdrfilm", "width": 1, "height": 1, "pixel_format": "luminance"}
        film |= {"rfilter": {"type": "box"}}
        props["film"] = mi.load_dict(film, parallel=False)
        sampler = {"type": "independent", "sample_count": photons}
        props["sampler"] = mi.load_dict(sampler, parallel=False)
        super().__init__(props)

    def to_string(self) -> str:
        return f"LightMeter[photons = {self.sampler().sample_count()}]"


mi.register_sensor("light_meter", LightMeter)
