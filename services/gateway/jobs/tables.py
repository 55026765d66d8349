"""Database tables of the jobs, as the migrations have made them."""

from __future__ import annotations

import sqlalchemy as sa

from capture2vr.gateway.database.database import metadata
from capture2vr.gateway.jobs.job import State
from capture2vr.storage.tenant_store import DEFAULT_TENANT

jobs = sa.Table(
    "jobs",
    metadata,
    # Ids begin with the time of creation, so their order is the order of the queue and of every listing.
    sa.Column("id", sa.String(64), primary_key=True),
    sa.Column("order", sa.JSON, nullable=False),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("stage", sa.String(32), nullable=False),
    sa.Column("fraction", sa.Double, nullable=False),
    sa.Column("elapsed_s", sa.Double, nullable=False),
    sa.Column("eta_s", sa.Double, nullable=False),
    sa.Column("preview", sa.JSON(none_as_null=True)),
    sa.Column("asset", sa.JSON(none_as_null=True)),
    sa.Column("error", sa.JSON(none_as_null=True)),
    sa.Column("warnings", sa.JSON, nullable=False),
    sa.Column("seconds", sa.JSON, nullable=False),
    sa.Column("last_event", sa.Integer, nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("updated", sa.Double, nullable=False),
    sa.Column("tenant", sa.String(32), nullable=False, server_default=DEFAULT_TENANT),
    sa.Column("token", sa.String(64), nullable=False, server_default=sa.text("''")),
    sa.Column("preset", sa.Text, sa.Computed("\"order\" ->> 'preset'")),
    sa.Index("ix_jobs_tenant_id", "tenant", "id"),
    # A claim looks here for the first queued job of each tenant, however long the queue.
    sa.Index("ix_jobs_queue", "state", "preset", "tenant", "id"),
)

leases = sa.Table(
    "leases",
    metadata,
    sa.Column("job", sa.ForeignKey("jobs.id"), primary_key=True),
    sa.Column("holder", sa.String(64), nullable=False),
    sa.Column("worker", sa.String(255), nullable=False),
    sa.Column("fence", sa.BigInteger, nullable=False),
    sa.Column("attempts", sa.Integer, nullable=False),
    sa.Column("until", sa.Double, nullable=False),
    sa.Column("not_before", sa.Double, nullable=False),
    sa.Column("run_seq", sa.BigInteger, nullable=False),
    sa.Column("cancel", sa.Boolean, nullable=False),
)

events = sa.Table(
    "events",
    metadata,
    # One sequence for all jobs: a process finds what others wrote by querying ids above the last that it has seen.
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
    sa.Column("job", sa.ForeignKey("jobs.id"), nullable=False),
    sa.Column("seq", sa.Integer, nullable=False),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("at", sa.Double, nullable=False),
    sa.Column("data", sa.JSON, nullable=False),
    sa.UniqueConstraint("job", "seq"),
)

job_counts = sa.Table(
    "job_counts",
    metadata,
    # Kept by triggers. Rows are added up: on Postgres each connection counts in one of its own.
    sa.Column("slot", sa.Integer, primary_key=True, autoincrement=False),
    *(sa.Column(state.lower(), sa.BigInteger, nullable=False, server_default=sa.text("0")) for state in State),
)

ended_jobs = sa.Table(
    "ended_jobs",
    metadata,
    # Filled by triggers: jobs that have ended, and still have their events of progress.
    sa.Column("job", sa.String(64), primary_key=True),
    sa.Column("ended", sa.Double, nullable=False, index=True),
)

queue_turns = sa.Table(
    "queue_turns",
    metadata,
    # No foreign key: a tenant of a job need not be in the table of tenants, as in a database of only jobs.
    sa.Column("tenant", sa.String(32), primary_key=True),
    sa.Column("served", sa.Double, nullable=False),
)

idempotency = sa.Table(
    "idempotency_keys",
    metadata,
    # The tenant's name, a space, and the key; of the default tenant the key alone, as it was before there were tenants.
    sa.Column("key", sa.String(255), primary_key=True),
    sa.Column("body_sha256", sa.String(64), nullable=False),
    sa.Column("job", sa.ForeignKey("jobs.id"), nullable=False),
)
