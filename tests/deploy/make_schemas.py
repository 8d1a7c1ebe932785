#!/usr/bin/env python3
"""Writes schemas.json: what the Kubernetes API and docker compose accept, cut down to what deploy/ uses.

Usage: make_schemas.py KUBERNETES_JSON_SCHEMA_DIR COMPOSE_SPEC.json >schemas.json

KUBERNETES_JSON_SCHEMA_DIR: e.g. v1.29.0-local-strict of the package kubernetes-validate; made from the API's own OpenAPI
description (Apache 2.0). "Strict": unknown fields are refused. COMPOSE_SPEC.json: of docker-compose 1.29 (Apache 2.0).
"""
import json
import sys

KINDS = {
    "v1/Namespace": "io.k8s.api.core.v1.Namespace",
    "v1/Service": "io.k8s.api.core.v1.Service",
    "apps/v1/Deployment": "io.k8s.api.apps.v1.Deployment",
    "apps/v1/StatefulSet": "io.k8s.api.apps.v1.StatefulSet",
    "autoscaling/v2/HorizontalPodAutoscaler": "io.k8s.api.autoscaling.v2.HorizontalPodAutoscaler",
    "networking.k8s.io/v1/NetworkPolicy": "io.k8s.api.networking.v1.NetworkPolicy",
}


def without_prose(node):
    """Leaves out descriptions (a property of that name is no string) and what only servers need."""
    if isinstance(node, dict):
        return {
            key: without_prose(value)
            for key, value in node.items()
            if not (key == "description" and isinstance(value, str)) and not key.startswith("x-kubernetes")
        }
    if isinstance(node, list):
        return [without_prose(value) for value in node]
    return node


def references(node):
    if isinstance(node, dict):
        for key, value in node.items():
            if key == "$ref":
                yield value.rsplit("/", 1)[1]
            else:
                yield from references(value)
    elif isinstance(node, list):
        for value in node:
            yield from references(value)


def main():
    kubernetes, compose = sys.argv[1:]
    with open(kubernetes + "/_definitions.json") as file:
        everything = json.load(file)
    everything = everything["$defs"]
    wanted, needed = {}, list(KINDS.values())
    while needed:
        name = needed.pop()
        if name not in wanted:
            wanted[name] = without_prose(everything[name])
            needed.extend(references(wanted[name]))
    with open(compose) as file:
        compose_schema = without_prose(json.load(file))
    text = json.dumps(
        {"kinds": KINDS, "kubernetes": {"$defs": wanted}, "compose": compose_schema}, sort_keys=True, indent=0
    )
    print(text.replace("/api/_definitions.json#", "#"))


main()
