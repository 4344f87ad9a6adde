"""Logs a training, an evaluation and weighings with MLflow: `with_python_mlflow.py URL TOKEN POWDER`. Prints one JSON document."""

import json
import pathlib
import sys
import tempfile
from importlib.metadata import version

import mlflow

from flip_powder import Client
from flip_powder import mlflow as flip_mlflow

url, token, powder = sys.argv[1:]
found: dict[str, object] = {"mlflow": version("mlflow-skinny")}
with tempfile.TemporaryDirectory() as folder, Client(url, token) as flip:
    mlflow.set_tracking_uri(f"sqlite:///{folder}/mlflow.db")
    mlflow.set_experiment(experiment_id=mlflow.create_experiment("powders", artifact_location=pathlib.Path(folder, "files").as_uri()))

    def ran(path: str, **body: object) -> str:
        answer = flip.request("POST", path, json=body).json()
        job = answer.get("job", answer)["id"]
        flip.wait(flip.job(job))
        return job

    service = mlflow.MlflowClient()
    dose = flip.weigh(powder, "12 mg", tolerance="3 mg")
    run = flip_mlflow.log_weighings(flip.weighings())
    found["weighings"] = [service.get_run(run).data.metrics["target_mg"], [it.path for it in service.list_artifacts(run)]]
    found["error"] = service.get_run(run).data.metrics["mean_absolute_error_mg"] == abs(dose.error_mg or 0.0)
    run = flip_mlflow.log_evaluation(flip, ran("/v1/evaluations", powders=[powder], targets_mg=[5], repeats=2, controllers=["paced"], particles=500))
    found["evaluation"] = service.get_run(run).data.metrics["paced.mae_mg"] < 5.0
    run = flip_mlflow.log_training(flip, ran("/v1/trainings", powders=[powder], episodes=20, surrogate_episodes=20))
    history = service.get_metric_history(run, "final_error_mg")
    data = service.get_run(run).data
    found["training"] = [len(history), history[-1].step, data.params["settings.seed"], data.tags["flip.policy"][:2]]
    found["policy"] = [it.path.endswith(".safetensors") for it in service.list_artifacts(run)]
print(json.dumps(found))
