"""MLflow: trainings, evaluations and weighings of a FLIP service as runs.

>>> import mlflow
>>> from flip_powder import Client, mlflow as flip_mlflow
>>> mlflow.set_experiment("powders")
>>> flip_mlflow.log_training(Client(), training_id)
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import mlflow
from mlflow.entities import Metric

from ._client import Client
from ._records import Weighing

#: Metrics that MLflow takes in one call.
_BATCH = 1000
#: Longest value of a parameter that every MLflow takes.
_PARAM = 500


def log_training(client: Client, id: str, *, artifact: bool = True) -> str:
    """Logs a training: its settings as parameters, each episode's numbers as metrics by episode, its policy as an
    artifact.

    Args:
        client: the service.
        id: id of the training, which is that of its job.
        artifact: whether to log the policy's bytes.

    Returns:
        The id of the run.
    """
    training = client.request("GET", f"/v1/trainings/{id}").json()
    with _run(f"training {id}", "training", training["job"]) as run:
        mlflow.log_params(dict(_flat({"order": training["order"], "settings": training["settings"]})))
        names = ("final_error_mg", "reward", "steps", "level", "alpha", "critic_loss", "actor_loss")
        metrics = []
        for episode in _pages(client, f"/v1/trainings/{id}/episodes"):
            metrics += [
                _metric(name, episode[name], episode["index"]) for name in names if episode.get(name) is not None
            ]
        _log(run, metrics)
        result = training.get("result")
        if result:
            mlflow.set_tag("flip.policy", result["policy"])
            mlflow.log_metric("mean_final_error_mg", result["final_error_mg"])
            if artifact:
                weights = client.request("GET", f"/v1/policies/{result['policy']}/weights").body
                _artifact(f"{result['policy']}.safetensors", weights)
        return str(run.info.run_id)


def log_evaluation(client: Client, id: str) -> str:
    """Logs an evaluation: each controller's errors as metrics, the table of cells as an artifact.

    Returns:
        The id of the run.
    """
    evaluation = client.request("GET", f"/v1/evaluations/{id}").json()
    result = evaluation.get("result") or {"rows": [], "summary": []}
    kept = ("policy", "controllers", "powders", "targets_mg", "repeats", "readability_mg", "max_shakes", "seed")
    with _run(f"evaluation {id}", "evaluation", evaluation["job"]) as run:
        mlflow.log_params(dict(_flat({name: evaluation[name] for name in kept})))
        for row in result["summary"]:
            numbers = {name: it for name, it in row.items() if isinstance(it, int | float)}
            mlflow.log_metrics({f"{row['controller']}.{name}": float(it) for name, it in numbers.items()})
        mlflow.log_dict(result, "evaluation.json")
        return str(run.info.run_id)


def log_weighings(weighings: Iterable[Weighing], *, name: str = "weighings") -> str:
    """Logs weighings as one run: reading, error and uncertainty of each as metrics by its place, in mg, and the
    records as an artifact.

    Returns:
        The id of the run.
    """
    doses = list(weighings)
    with mlflow.start_run(run_name=name, tags={"flip.kind": "weighings"}) as run:
        metrics = []
        for place, dose in enumerate(doses):
            uncertainty = dose.measured.uncertainty_mg if dose.measured else None
            numbers = {
                "target_mg": dose.target_mg,
                "reading_mg": dose.reading_mg,
                "error_mg": dose.error_mg,
                "uncertainty_mg": uncertainty,
                "shakes": dose.shakes,
                "seconds": dose.seconds,
            }
            metrics += [_metric(key, it, place) for key, it in numbers.items() if it is not None]
        _log(run, metrics)
        errors = [abs(dose.error_mg) for dose in doses if dose.error_mg is not None]
        if errors:
            mlflow.log_metric("mean_absolute_error_mg", sum(errors) / len(errors))
        mlflow.log_dict({"weighings": [dict(dose.raw) for dose in doses]}, "weighings.json")
        return str(run.info.run_id)


def _run(name: str, kind: str, job: Mapping[str, Any]) -> Any:
    tags = {"flip.kind": kind, "flip.job": job["id"], "flip.state": job["state"]}
    return mlflow.start_run(run_name=name, tags=tags)


def _metric(name: str, value: float, step: int) -> Metric:
    return Metric(key=name, value=float(value), timestamp=0, step=step)


def _log(run: Any, metrics: list[Metric]) -> None:
    client = mlflow.MlflowClient()
    for begin in range(0, len(metrics), _BATCH):
        client.log_batch(run.info.run_id, metrics=metrics[begin : begin + _BATCH])


def _artifact(name: str, content: bytes) -> None:
    import pathlib
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, name)
        path.write_bytes(content)
        mlflow.log_artifact(str(path))


def _flat(data: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested settings as parameters: names joined by dots, everything else as JSON."""
    for name, value in data.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            text = value if isinstance(value, str) else json.dumps(value)
            yield prefix + name, text[:_PARAM]


def _pages(client: Client, path: str) -> Iterator[dict[str, Any]]:
    after: str | None = None
    while True:
        page = client.request("GET", path, params={"limit": 200, "after": after}).json()
        yield from page["items"]
        after = page.get("next")
        if after is None:
            return
