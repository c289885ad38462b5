# One image for every part of the scale-out shape: web, worker, scheduler, migrations (docker-compose.yml).
FROM python:3.13-slim-trixie AS build
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1
RUN python -m venv /opt/cs3d
WORKDIR /src
# First what changes rarely. Hashes decide what is installed.
COPY requirements/build.txt requirements/server.txt requirements/
RUN /opt/cs3d/bin/pip install --require-hashes -r requirements/build.txt -r requirements/server.txt
COPY pyproject.toml README.md LICENSE ./
COPY evaluator evaluator
COPY server server
COPY worker worker
COPY client client
COPY migrations migrations
COPY templates templates
RUN /opt/cs3d/bin/pip install --no-deps --no-build-isolation .

FROM python:3.13-slim-trixie
RUN useradd --uid 10001 --create-home --home-dir /data cs3d
COPY --from=build /opt/cs3d /opt/cs3d
ENV PATH=/opt/cs3d/bin:$PATH CS3D_DATA_DIR=/data PYTHONUNBUFFERED=1
USER 10001
WORKDIR /data
VOLUME /data
EXPOSE 8000
CMD ["cs3d-admin", "serve", "--host", "0.0.0.0", "--port", "8000"]
