"""The HTTP interface, one file a noun."""

from fastapi import APIRouter

from residuum.service.api import (
    alarms,
    analyses,
    asset_models,
    assets,
    audit,
    control_views,
    diagnosers,
    effect_catalogue,
    events,
    failure_modes,
    frequency_responses,
    jobs,
    model_views,
    models,
    records,
    score,
    sources,
    uncertainties,
    window_views,
    windows,
)

ROUTERS: tuple[APIRouter, ...] = (
    score.router,
    diagnosers.router,
    failure_modes.router,
    assets.router,
    asset_models.router,
    windows.router,
    window_views.router,
    alarms.router,
    audit.router,
    records.router,
    frequency_responses.router,
    uncertainties.router,
    model_views.router,
    models.router,
    effect_catalogue.router,
    analyses.router,
    control_views.router,
    jobs.router,
    events.router,
    sources.router,
)
"""The routes under /api/v1."""
