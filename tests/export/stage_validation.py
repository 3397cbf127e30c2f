"""What two validators have to say about a stage: OpenUSD's own and NVIDIA's."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from collections.abc import Container
from pathlib import Path
from typing import Any

import usd_validation_nvidia as nvidia
from pxr import Usd, UsdValidation


def usd_errors(stage: Any) -> list[str]:
    """Messages of every validator that OpenUSD has, instances looked into."""
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage, Usd.TraverseInstanceProxies())
    return [error.GetMessage() for error in errors]


def nvidia_issues(path: Path, not_applicable: Container[str] = ()) -> list[str]:
    """Issues of any severity that NVIDIA's validator finds with its default rules, but for some."""
    results = nvidia.ValidationEngine().validate(str(path))
    named = [(getattr(issue.rule, "__name__", "no rule"), issue.message) for issue in results]
    return [f"{rule}: {message}" for rule, message in named if rule not in not_applicable]
