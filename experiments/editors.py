"""Edits as the programs of editors make them, and what a little more training leaves of an edit.

Incorporations are harmonised, modifications are optimised for edited views with or without
densification, and removals are inpainted. Laundered cases are those after which the whole scene was
trained a little more. Cases of cases.py are edited here; the bank has such cases of other scenes.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
from cases import DATA, Case, case_of, edit_scene, load_scene, make_case, siblings_of, tampered
from cut_object import cut_object
from harmonised import incorporate
from inpainted import inpaint_region
from optimised import laundered, optimise_region

from gsc_jax.benchmark.tamper import Edit, Proposal
from gsc_jax.scene import Gaussians

Family = Literal["quick", "editor", "laundered"]
UNTOUCHED = "none"
"""Family of authentic scenes that were not laundered."""


def program_of(edit: Edit, donor: Gaussians | None = None, *, densify: bool = True) -> Proposal:
    """The program that makes a kind of edit; an incorporation needs an object to paste.

    With `densify`, the region of a modification is densified while it is optimised.
    """
    if edit == "incorporation":
        if donor is None:
            raise ValueError("an incorporation needs an object to paste")
        return functools.partial(incorporate, donor=donor)
    if edit == "removal":
        return inpaint_region
    return functools.partial(optimise_region, densify=densify)


def case_of_family(name: str, edit: Edit, seed: int, family: Family, data: Path = DATA) -> Case:
    """Edit a scene quickly, by the program of an editor, or quickly with a laundering after it."""
    if family == "quick":
        return make_case(name, edit, seed, data)
    scene = load_scene(name, data)
    if family == "editor":
        return case_of(scene, tampered(scene, (edit, program(name, edit, seed, data)), seed), seed)
    edited = edit_scene(name, edit, seed, data)
    trained = laundered(edited.gaussians, scene.cameras)
    return case_of(scene, dataclasses.replace(edited, gaussians=trained), seed)


def laundered_without_edit(authentic: Case) -> Case:
    """The case of an authentic scene that was trained a little more: no edit."""
    trained = laundered(authentic.scene.gaussians, authentic.scene.cameras)
    return dataclasses.replace(authentic, gaussians=jax.tree.map(jnp.asarray, trained))


def source_of_object(name: str, seed: int) -> str:
    """Name of the scene from which the object of a harmonised incorporation is cut."""
    _, others = siblings_of(name)
    return others[seed % len(others)]


def program(name: str, edit: Edit, seed: int, data: Path = DATA) -> Proposal:
    """The program of a kind of edit; objects are cut from another scene, roughly for odd seeds."""
    if edit != "incorporation":
        return program_of(edit)
    source = load_scene(source_of_object(name, seed), data)
    return program_of(
        edit, cut_object(source.gaussians, source.cameras, seed=seed, rough=bool(seed % 2))
    )
