FROM python:3.11-slim AS build
# Where PyTorch comes from, at the version of constraints.txt. Its CPU build is a tenth of the size of the CUDA build, which
# PyPI itself has: --build-arg TORCH_INDEX=https://pypi.org/simple
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY services ./services
RUN python -m venv /venv && /venv/bin/pip install --no-cache-dir -c constraints.txt \
    --extra-index-url "$TORCH_INDEX" '.[edge,storage]'

FROM python:3.11-slim
RUN useradd --system --uid 10001 --create-home capture2vr
COPY --from=build /venv /venv
# Scratch is the only thing written, checkpoints included: mount a disk here that outlives the container.
RUN mkdir -p /scratch && chown capture2vr /scratch
ENV PATH=/venv/bin:$PATH PYTHONUNBUFFERED=1 EDGE_HOST=0.0.0.0 EDGE_PORT=50051 EDGE_SCRATCH=/scratch
USER 10001
EXPOSE 50051
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=5s --timeout=3s --start-period=20s CMD ["python", "-m", "services.edge.health"]
ENTRYPOINT ["capture2vr"]
CMD ["edge"]
