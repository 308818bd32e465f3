# One image for the services, the flow and the desk; docker-compose.yml gives each container its command.

# Pin a digest here where builds must be reproducible: --build-arg BASE=python:3.11-slim@sha256:...
ARG BASE=python:3.11.14-slim-bookworm

FROM ${BASE} AS build
# Options for pip, e.g. "--index-url URL". Without a CPU index, PyPI's torch brings gigabytes of CUDA along.
ARG PIP_ARGS="--extra-index-url https://download.pytorch.org/whl/cpu"
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1
RUN python3 -m venv /opt/venv
COPY requirements.lock /tmp/requirements.lock
# PIP_ARGS is left unquoted: it is several words.
RUN /opt/venv/bin/python -m pip install ${PIP_ARGS} --requirement /tmp/requirements.lock

FROM ${BASE}
# rasterio's wheel links to the system's libexpat, which the slim image does not carry.
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libexpat1 \
    && rm -rf /var/lib/apt/lists/* \
    && groupadd --gid 10001 smokeglint \
    && useradd --uid 10001 --gid 10001 --home-dir /tmp --no-create-home --shell /usr/sbin/nologin smokeglint \
    && install --directory --owner=10001 --group=10001 /keys /stores /work
COPY --from=build /opt/venv /opt/venv
WORKDIR /app
COPY shared shared
COPY services services
COPY flows flows
# The root file system is read-only when this runs, so byte code is made here.
RUN /opt/venv/bin/python -m compileall -q shared services flows
# Only the volumes and /tmp are written to. Spinning OpenMP threads cost eight times the time on shared cores.
ENV PATH=/opt/venv/bin:$PATH \
    PYTHONPATH=/app \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    HOME=/tmp \
    NUMBA_CACHE_DIR=/tmp/numba \
    MPLCONFIGDIR=/tmp/matplotlib \
    MPLBACKEND=Agg \
    OMP_NUM_THREADS=2 \
    OMP_WAIT_POLICY=PASSIVE
USER 10001:10001
VOLUME /keys /stores /work
EXPOSE 8000 8001 8002 8003 8004 8005
CMD ["uvicorn", "services.access.app:app", "--host", "0.0.0.0", "--port", "8001", "--no-access-log"]
