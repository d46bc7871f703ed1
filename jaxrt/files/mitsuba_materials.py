"""Colours, BSDFs and area emitters of a Mitsuba scene as parts."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

import numpy as np

from .. import parts
from . import spectra
from .conductors import CONDUCTORS
from .indices import INDICES
from .mitsuba_composites import READERS
from .mitsuba_context import Context
from .mitsuba_principled import RATES, principled, principled_thin
from .mitsuba_textures import TEXTURES, as_number, texture
from .mitsuba_xml import Element


def color(ctx: Context, element: Element, name: str, default: Any, role: spectra.Role) -> Any:
    """A colour parameter: one number for a grey, else linear sRGB (3,). `default` where it is not given.

    A <float> is grey in any role; a <spectrum> of one number is grey as a reflectance, but as a radiance
    it is the colour of the equal-energy spectrum (Mitsuba 3, rgb variants).
    """
    nested = ctx.named(element, name)
    if nested is not None and nested.tag == "texture" and nested.plugin in TEXTURES:
        return texture(ctx, nested, color, 1.0 if role == "reflectance" else np.inf)
    if nested is not None:
        return _spectrum_plugin(ctx, nested)
    given = ctx.get(element, name, "rgb", "float", "integer", "spectrum")
    if given is None:
        return default
    if given.kind != "spectrum":
        return given.content
    if isinstance(given.content, float):
        return given.content * spectra.EQUAL_ENERGY if role == "radiance" else given.content
    wavelengths, values = given.content
    rgb, clipped = spectra.to_rgb(wavelengths, values, role)
    if clipped:
        ctx.notes.append(f"{given.node.label}: is outside the sRGB gamut, and is clipped to it")
    return rgb


_SPECTRA = ("d65", "uniform", "srgb", "rawconstant")


def _spectrum_plugin(ctx: Context, element: Element) -> Any:
    """`d65` (white of luminance 1, times scale and color), `uniform` and `rawconstant`, which are grey in Mitsuba's rgb
    variants, or `srgb`. Its others have no colour there."""
    if element.tag not in ("spectrum", "texture") or element.plugin not in _SPECTRA:
        what = "an <rgb>, a <spectrum value> or a spectrum of type"
        element.fail(f"is not supported as a colour; give {what} {', '.join(_SPECTRA)}")
    if element.plugin == "uniform":
        result: Any = ctx.number(element, "value")
    elif element.plugin == "rawconstant":
        given = ctx.get(element, "value", "float", "integer", "vector", "point")
        result = element.fail("has no value; add one") if given is None else given.content
    else:
        given = ctx.get(element, "color", "rgb")
        if given is None and element.plugin == "srgb":
            element.fail("has no color; add an <rgb>")
        result = ctx.number(element, "scale", 1.0) * (1.0 if given is None else given.content)
    ctx.finish(element)
    return result


def bsdf(ctx: Context, element: Element, place: str) -> parts.Bsdf:
    """One part for an element, however often it is referenced. `place`: its name if it has no id."""

    def build() -> parts.Bsdf:
        if element.plugin not in _BSDFS:
            element.fail(f"is not supported; use {', '.join(_BSDFS)}")
        name = ctx.name(element, place)
        fields = _BSDFS[element.plugin][1](ctx, element, name)
        ctx.finish(element, dict.fromkeys(("sample_visible", *RATES), ""))
        return ctx.part(element, _BSDFS[element.plugin][0], id=name, **fields)

    return ctx.once(element, build)


def _diffuse(ctx: Context, element: Element, name: str) -> dict[str, Any]:
    return {"reflectance": color(ctx, element, "reflectance", 0.5, "reflectance")}


def _conductor(ctx: Context, element: Element, name: str) -> dict[str, Any]:
    material = ctx.string(element, "material")
    if not material:
        eta, k = (color(ctx, element, key, CONDUCTORS["none"][i], "ior") for i, key in enumerate(("eta", "k")))
    else:
        if element.names & {"eta", "k"}:
            element.fail("has a material and also eta or k; give only one kind")
        if material not in CONDUCTORS:
            element.fail(f"material {material[:80]!r} is not known; {_close(material, CONDUCTORS, 'eta and k')}")
        eta, k = CONDUCTORS[material]
    return {
        "eta": eta,
        "k": k,
        "specular_reflectance": color(ctx, element, "specular_reflectance", 1.0, "reflectance"),
    }


def _rough_conductor(ctx: Context, element: Element, name: str) -> dict[str, Any]:
    rough = _microfacets(ctx, element)
    return {**rough, "distribution": _SEPARABLE[rough["distribution"]], **_conductor(ctx, element, name)}


def _microfacets(ctx: Context, element: Element) -> dict[str, Any]:
    """Roughness and distribution, with Mitsuba's defaults."""
    distribution = ctx.string(element, "distribution", "beckmann").lower()
    if distribution not in _SEPARABLE:
        element.fail(f"distribution {distribution[:80]!r} is not known; give beckmann or ggx")
    both = [key in element.names for key in ("alpha_u", "alpha_v")]
    if any(both) and (not all(both) or "alpha" in element.names):
        element.fail("has only part of its roughness; give alpha, or both alpha_u and alpha_v")
    alpha = [_roughness(ctx, element, key) for key in (("alpha_u", "alpha_v") if any(both) else ("alpha",))]
    return {"alpha": alpha, "distribution": distribution}


_SEPARABLE = {"beckmann": "beckmann", "ggx": "ggx_separable"}


def _index(ctx: Context, element: Element, name: str, default: str) -> float:
    """An index of refraction, by number or by name."""
    if name in element.values and element.values[name].kind != "string":
        return ctx.number(element, name)
    material = ctx.string(element, name, default)
    if material.lower() not in INDICES:
        element.fail(f"{name} {material[:80]!r} is not known; {_close(material, INDICES, 'a number')}")
    return INDICES[material.lower()]


def _close(name: str, known: Iterable[str], instead: str) -> str:
    close = [k for k in known if k.lower() == name.lower()] or difflib.get_close_matches(name, known, 3, 0.4)
    return f"did you mean {' or '.join(close)}?" if close else f"give {instead} instead"


def _boundary(ctx: Context, element: Element, inside: str, **albedos: float) -> dict[str, Any]:
    """Indices on both sides, `inside` by default that of this medium, and colours with their defaults."""
    fields: dict[str, Any] = {k: _index(ctx, element, k, d) for k, d in (("int_ior", inside), ("ext_ior", "air"))}
    return fields | {key: color(ctx, element, key, default, "reflectance") for key, default in albedos.items()}


def _dielectric(ctx: Context, element: Element, name: str) -> dict[str, Any]:
    return _boundary(ctx, element, "bk7", specular_reflectance=1.0, specular_transmittance=1.0)


def _thin_dielectric(ctx: Context, element: Element, name: str) -> dict[str, Any]:
    return {**_dielectric(ctx, element, name), "thin": True}


def _rough_dielectric(ctx: Context, element: Element, name: str) -> dict[str, Any]:
    return {**_dielectric(ctx, element, name), **_microfacets(ctx, element)}


def _plastic(ctx: Context, element: Element, name: str) -> dict[str, Any]:
    fields = _boundary(ctx, element, "polypropylene", diffuse_reflectance=0.5, specular_reflectance=1.0)
    return {**fields, "nonlinear": ctx.boolean(element, "nonlinear", False)}


def _rough_plastic(ctx: Context, element: Element, name: str) -> dict[str, Any]:
    return {**_plastic(ctx, element, name), **_microfacets(ctx, element)}


def _roughness(ctx: Context, element: Element, name: str) -> Any:
    alpha = color(ctx, element, name, 0.1, "ior")
    if isinstance(alpha, parts.Texture):
        return as_number(alpha)
    alpha = np.atleast_1d(alpha)
    if (alpha != alpha[0]).any():
        element.fail(f"{name} is a colour; give a <float>")
    # Mitsuba keeps what is rough from becoming mirrors; a wrong number is left for the part to refuse
    return max(float(alpha[0]), 1e-4) if alpha[0] >= 0 else float(alpha[0])


_BSDFS: dict[str, tuple[Any, Any]] = {
    "diffuse": (parts.Diffuse, _diffuse),
    "conductor": (parts.Conductor, _conductor),
    "roughconductor": (parts.Conductor, _rough_conductor),
    "dielectric": (parts.Dielectric, _dielectric),
    "thindielectric": (parts.Dielectric, _thin_dielectric),
    "roughdielectric": (parts.Dielectric, _rough_dielectric),
    "plastic": (parts.Plastic, _plastic),
    "roughplastic": (parts.Plastic, _rough_plastic),
    "principled": (parts.Principled, principled),
    "principledthin": (parts.PrincipledThin, principled_thin),
    "null": (parts.Null, lambda ctx, element, name: {}),
}
for _plugin, (_part, _read) in READERS.items():
    _BSDFS[_plugin] = _part, lambda ctx, element, name, read=_read: read(ctx, element, name, bsdf, color)


SAMPLING = {"sampling_weight": "is a matter of sampling, and has no effect here"}
"""Parameters of emitters that change no picture."""


UNSEEN = "directionalarea"
"""Mitsuba's emitter along the normals of a shape. Only a path that begins at it has that direction, so `path` and its
like see a black surface; light tracing alone sees its light."""


def area_emission(ctx: Context, element: Element, place: str) -> tuple[Any, str]:
    """Radiance of an area emitter (None of one that nothing sees) and its name: the same two for every shape that
    references it."""

    def build() -> tuple[Any, str]:
        if element.plugin not in ("area", UNSEEN):
            element.fail("cannot stand in a shape; use an area emitter there")
        if "to_world" in element.values:
            element.fail("has a to_world, but moves with its shape; remove it")
        name = ctx.name(element, place)
        radiance = color(ctx, element, "radiance", 1.0, "radiance")
        ctx.finish(element, SAMPLING)
        emission = ctx.part(element, lambda: parts.varying(radiance, f"{name}.radiance"))
        if element.plugin == UNSEEN:
            ctx.notes.append(
                f"{element.node.label}: is seen by light tracing alone; here, as in Mitsuba's path, it is dark"
            )
        return (None if element.plugin == UNSEEN else emission), name

    return ctx.once(element, build)
