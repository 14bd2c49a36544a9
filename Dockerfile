FROM python:3.12-slim AS build
WORKDIR /src
COPY deploy/image.lock ./
RUN python -m venv /opt/residuum && /opt/residuum/bin/pip install --no-cache-dir --require-hashes -r image.lock
COPY pyproject.toml setup.py mkdocs.yml README.md LICENSE ./
COPY docs ./docs
COPY residuum ./residuum
RUN /opt/residuum/bin/pip install --no-cache-dir --no-deps ".[postgres,mqtt,oidc,opcua,sparkplug,parquet]"

FROM python:3.12-slim
RUN useradd --uid 10001 --no-create-home residuum && install -d -o residuum /var/lib/residuum /var/lib/residuum-keys
COPY --from=build /opt/residuum /opt/residuum
ENV PATH=/opt/residuum/bin:$PATH NUMBA_CACHE_DIR=/tmp/residuum RESIDUUM_CACHE=/tmp/residuum PYTHONUNBUFFERED=1
USER residuum
EXPOSE 8000
CMD ["residuum", "serve"]
