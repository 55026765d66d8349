FROM python:3.11-slim AS build
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY services ./services
RUN python -m venv /venv && /venv/bin/pip install --no-cache-dir -c constraints.txt '.[edge,storage]'

FROM python:3.11-slim
RUN useradd --system --uid 10001 --create-home capture2vr
COPY --from=build /venv /venv
# Scratch is the only thing written: mount a tmpfs or a disk here; the rest runs read-only.
RUN mkdir -p /scratch && chown capture2vr /scratch
ENV PATH=/venv/bin:$PATH PYTHONUNBUFFERED=1 EDGE_HOST=0.0.0.0 EDGE_PORT=50051 EDGE_SCRATCH=/scratch
USER 10001
EXPOSE 50051
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=5s --timeout=3s --start-period=20s CMD ["python", "-m", "services.edge.health"]
ENTRYPOINT ["capture2vr"]
CMD ["edge"]
