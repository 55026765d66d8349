"""Conversion between database rows and the data classes Job and Event."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

import sqlalchemy as sa

from capture2vr.gateway.jobs.job import Event, Job, Lease, Order, State
from capture2vr.gateway.jobs.tables import events, jobs, leases
from capture2vr.sentences.documents import with_codes, with_sentences
from capture2vr.sentences.sentence import Sentence, read_sentence

WHOLE_JOB = sa.select(jobs, *[column.label(f"lease_{column.name}") for column in leases.c]).join(leases)
"""SELECT of a job joined with its lease: all columns of a Job."""

_WITH_SENTENCES = ("error", "preview", "asset")
_LEASE_FIELDS = tuple(field.name for field in fields(Lease))


def job_from_row(row: sa.Row[Any]) -> Job:
    """Convert a row of WHOLE_JOB to a Job."""
    values = dict(row._mapping)
    lease = {name: values.pop(f"lease_{name}") for name in _LEASE_FIELDS}
    del values["lease_job"], values["preset"]  # which is the order's
    return Job(
        **{
            **values,
            "order": Order.of(values["order"]),
            "state": State(values["state"]),
            "warnings": tuple(_coded(each) for each in values["warnings"]),
            **{member: with_sentences(values[member]) for member in _WITH_SENTENCES},
            "lease": Lease(**lease),
        }
    )


def job_values(job: Job) -> dict[str, Any]:
    """Return the job's column values for the table `jobs`."""
    values = {column.name: getattr(job, column.name) for column in jobs.c if column.computed is None}
    return {
        **values,
        "order": job.order.as_json,
        "state": job.state.value,
        "warnings": [_stored(each) for each in job.warnings],
        **{member: with_codes(getattr(job, member)) for member in _WITH_SENTENCES},
    }


def lease_values(job: Job) -> dict[str, Any]:
    """Return the lease's column values for the table `leases`."""
    return {"job": job.id, **asdict(job.lease)}


def event_from_row(row: sa.Row[Any]) -> Event:
    """Convert a row of `events` to an Event."""
    return Event(row.job, row.seq, row.kind, row.at, with_sentences(row.data))


def event_values(event: Event) -> dict[str, Any]:
    """Return the event's column values for the table `events`."""
    values = {column.name: getattr(event, column.name) for column in events.c if column.name != "id"}
    return {**values, "data": with_codes(event.data)}


def _stored(warning: str) -> str | dict[str, Any]:
    """Return a warning as the column has it: with its code if it has one; those of older gateways are texts."""
    return {"text": warning.english, **warning.coded} if isinstance(warning, Sentence) else warning


def _coded(stored: str | Mapping[str, Any]) -> str:
    return stored if isinstance(stored, str) else read_sentence(str(stored.get("text", "")), stored)
