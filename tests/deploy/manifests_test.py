#!/usr/bin/env python3
"""What deploy/ promises, read from its files: they run everywhere, without an engine or a cluster.

Each rule is a function from parsed files to complaints. The files as they are must have none; for each rule there is a planted
fault that it must find. Usage: manifests_test.py PROJECT_ROOT PROGRAMS_DIR
"""
import copy
import functools
import json
import pathlib
import re
import subprocess
import sys
import unittest

import jsonschema
import yaml

ROOT = pathlib.Path(sys.argv[1])
PROGRAMS = pathlib.Path(sys.argv[2])
DEPLOY = ROOT / "deploy"
SCHEMAS = json.loads((ROOT / "tests/deploy/schemas.json").read_text())


def by_path(errors):
    return [f"{'.'.join(map(str, error.absolute_path))}: {error.message}" for error in errors]


@functools.cache
def help_words(program):
    """The options that a program answers to."""
    text = subprocess.run([PROGRAMS / program, "--help"], capture_output=True, text=True, check=True).stdout
    return set(re.findall(r"--[a-z-]+", text))


def option_complaints(where, words):
    """Words of a command line: a program of ours, then its options."""
    words = [word for word in words if word]
    if not words or not words[0].rsplit("/", 1)[-1].startswith("gleaner"):
        return [f"{where}: expected one of the farm's programs, found {words[:1]}"]
    known = help_words(words[0].rsplit("/", 1)[-1])
    options = [word.split("=")[0] for word in words[1:] if word.startswith("--")]
    return [f"{where}: {words[0]} has no option {option}" for option in options if option not in known]


# ------------------------------------------------------------------------------------------------ docker compose


def read_compose():
    text = (DEPLOY / "docker-compose.yml").read_text()
    text = re.sub(r"\$\{[A-Z_]+:-([^}]*)\}", r"\1", text)
    if "${" in text:
        raise ValueError("docker-compose.yml: expected a default for every variable")
    return yaml.safe_load(text)


def compose_complaints(compose):
    found = by_path(jsonschema.Draft7Validator(SCHEMAS["compose"]).iter_errors(compose))
    if found:
        return found
    services = compose["services"]
    for name, service in services.items():
        for key, expected in (
            ("read_only", True),
            ("cap_drop", ["ALL"]),
            ("security_opt", ["no-new-privileges:true"]),
        ):
            if service.get(key) != expected:
                found.append(f"{name}.{key}: expected {expected}, found {service.get(key)}")
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            if not source.startswith((".", "/")) and source not in compose["volumes"]:
                found.append(f"{name}.volumes: {source} is not declared")
        if not any(mount.startswith("/tmp:size=") for mount in service.get("tmpfs", [])):
            found.append(f"{name}.tmpfs: expected a bounded /tmp")
        for port in service.get("ports", []):
            if not port.startswith("127.0.0.1:"):
                found.append(f"{name}.ports: {port} is open to other machines")
    for name in ("coordinator", "worker"):
        service = services[name]
        for key in ("mem_limit", "pids_limit", "cpus", "stop_grace_period", "restart", "logging"):
            if key not in service:
                found.append(f"{name}: expected {key}")
        found += option_complaints(f"{name}.command", service["command"].split())
    coordinator, worker = services["coordinator"], services["worker"]
    if "test" not in coordinator.get("healthcheck", {}):
        found.append("coordinator: expected a healthcheck")
    else:
        found += option_complaints("coordinator.healthcheck", coordinator["healthcheck"]["test"][1:])
    if not any(volume.endswith(":/data") for volume in coordinator.get("volumes", [])):
        found.append("coordinator.volumes: expected one for /data")
    if worker.get("depends_on", {}).get("coordinator", {}).get("condition") != "service_healthy":
        found.append("worker.depends_on: expected a healthy coordinator")
    for key in ("container_name", "hostname", "ports"):
        if key in worker:
            found.append(f"worker.{key}: then --scale has no effect")
    dockerfile = coordinator.get("build", {}).get("dockerfile", "")
    if not (ROOT / dockerfile).is_file():
        found.append(f"coordinator.build: no file {dockerfile}")
    return found


# ------------------------------------------------------------------------------------------------ Kubernetes


def read_kubernetes():
    objects = []
    for file in yaml.safe_load((DEPLOY / "kubernetes/kustomization.yaml").read_text())["resources"]:
        objects += [one for one in yaml.safe_load_all((DEPLOY / "kubernetes" / file).read_text())]
    return objects


def schema_complaints(objects):
    found = []
    for one in objects:
        kind = f"{one.get('apiVersion')}/{one.get('kind')}"
        name = f"{one.get('kind')} {one.get('metadata', {}).get('name')}"
        if kind not in SCHEMAS["kinds"]:
            found.append(f"{name}: {kind} is not among the kinds of tests/deploy/make_schemas.py")
            continue
        schema = {"$ref": "#/$defs/" + SCHEMAS["kinds"][kind], "$defs": SCHEMAS["kubernetes"]["$defs"]}
        found += [f"{name}: {text}" for text in by_path(jsonschema.Draft7Validator(schema).iter_errors(one))]
    return found


def pod_complaints(name, template, claims):
    found = []
    pod = template["spec"]
    if not pod.get("securityContext", {}).get("runAsNonRoot"):
        found.append(f"{name}: expected runAsNonRoot")
    user = re.search(r"^USER (\d+):(\d+)$", (DEPLOY / "Dockerfile").read_text(), re.M)
    if pod["securityContext"].get("runAsUser") != int(user[1]):
        found.append(f"{name}: runAsUser: expected the image's {user[1]}")
    if "terminationGracePeriodSeconds" not in pod:
        found.append(f"{name}: expected a grace time for the batch that runs")
    volumes = {volume["name"] for volume in pod.get("volumes", [])} | claims
    for container in pod["containers"]:
        where = f"{name}.{container['name']}"
        found += option_complaints(where, container["args"])
        context = container.get("securityContext", {})
        if not context.get("readOnlyRootFilesystem") or context.get("allowPrivilegeEscalation") is not False:
            found.append(f"{where}: expected a read-only root and no privilege escalation")
        if "memory" not in container.get("resources", {}).get("limits", {}):
            found.append(f"{where}: expected a limit of memory")
        for mount in container.get("volumeMounts", []):
            if mount["name"] not in volumes:
                found.append(f"{where}: no volume {mount['name']}")
        ports = {port["name"]: port["containerPort"] for port in container.get("ports", [])}
        listened = {int(number) for number in re.findall(r":(\d+)(?:\s|$)", " ".join(container["args"]))}
        for port_name, number in ports.items():
            if number not in listened:
                found.append(f"{where}: port {port_name}: nothing listens on {number}")
        for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
            asked = container.get(probe, {})
            port = asked.get("httpGet", {}).get("port", asked.get("grpc", {}).get("port"))
            if asked and port not in ports and port not in ports.values():
                found.append(f"{where}.{probe}: no port {port}")
    return found


def kubernetes_complaints(objects):
    found = schema_complaints(objects)
    if found:
        return found
    named = {(one["kind"], one["metadata"]["name"]): one for one in objects}
    pods = {}
    for (kind, name), one in named.items():
        if kind != "Namespace" and one["metadata"].get("namespace") != "gleaner":
            found.append(f"{kind} {name}: expected the namespace gleaner")
        if kind in ("Deployment", "StatefulSet"):
            template = one["spec"]["template"]
            pods[name] = template
            claims = {claim["metadata"]["name"] for claim in one["spec"].get("volumeClaimTemplates", [])}
            if one["spec"]["selector"]["matchLabels"] != template["metadata"]["labels"]:
                found.append(f"{kind} {name}: its selector does not match its pods' labels")
            found += pod_complaints(f"{kind} {name}", template, claims)
    for (kind, name), one in named.items():
        selector = None
        if kind == "Service":
            selector = one["spec"]["selector"]
        if kind == "NetworkPolicy":
            selector = one["spec"]["podSelector"]["matchLabels"]
        if selector is not None and selector not in [pod["metadata"]["labels"] for pod in pods.values()]:
            found.append(f"{kind} {name}: selects no pod")
        if kind == "StatefulSet" and ("Service", one["spec"]["serviceName"]) not in named:
            found.append(f"StatefulSet {name}: no service {one['spec']['serviceName']}")
        if kind == "HorizontalPodAutoscaler":
            target = one["spec"]["scaleTargetRef"]
            if (target["kind"], target["name"]) not in named:
                found.append(f"{kind} {name}: no {target['kind']} {target['name']}")
            elif "replicas" in named[target["kind"], target["name"]]["spec"]:
                found.append(f"{kind} {name}: its target has a count of its own")
            page = (ROOT / "coordinator/gateway/metrics_page.cpp").read_text()
            for metric in one["spec"]["metrics"]:
                if f'"{metric["external"]["metric"]["name"]}"' not in page:
                    found.append(f"{kind} {name}: the coordinator has no metric {metric['external']['metric']['name']}")
    called = [arg for arg in pods["worker"]["spec"]["containers"][0]["args"] if arg.startswith("--coordinator=")]
    host, _, port = called[0].split("=")[1].partition(":") if called else ("", "", "0")
    service = named.get(("Service", host))
    if service is None or int(port) not in [one["port"] for one in service["spec"]["ports"]]:
        found.append(f"Deployment worker: calls {host}:{port}, which no service answers")
    return found


# ------------------------------------------------------------------------------------------------ Slurm, systemd, the image


def read_commands():
    """Command lines of the Slurm script and the systemd units, by where they stand."""
    commands = {}
    for line in (DEPLOY / "slurm/workers.sbatch").read_text().splitlines():
        if line.startswith('"$bin/'):
            commands["workers.sbatch"] = line.replace('"', "").rstrip("& ").split()
    for unit in sorted((DEPLOY / "systemd").glob("*.service")):
        for line in unit.read_text().splitlines():
            if line.startswith("ExecStart="):
                commands[unit.name] = line.partition("=")[2].split()
    return commands


def command_complaints(commands):
    found = [] if len(commands) == 3 else [f"expected three command lines, found {sorted(commands)}"]
    for where, words in commands.items():
        found += option_complaints(where, words)
    return found


def read_image():
    return {
        "dockerfile": (DEPLOY / "Dockerfile").read_text(),
        "ignore": (DEPLOY / "Dockerfile.dockerignore").read_text().splitlines(),
        "rooms": re.search(r"set\(rooms (scene [^)]*proto[^)]*)\)", (ROOT / "CMakeLists.txt").read_text())[1].split(),
    }


def image_complaints(image):
    found = []
    for room in image["rooms"]:
        if room != "bench" and f"!{room}" not in image["ignore"]:
            found.append(f"Dockerfile.dockerignore: the build needs {room}/")
    for path in ("CMakeLists.txt", "cmake"):
        if f"!{path}" not in image["ignore"]:
            found.append(f"Dockerfile.dockerignore: the build needs {path}")
    if image["ignore"][1:2] != ["*"]:
        found.append("Dockerfile.dockerignore: expected to leave out all that it does not name")
    stages = re.split(r"^FROM ", image["dockerfile"], flags=re.M)
    if not re.search(r"^USER [1-9]\d*:[1-9]\d*$", stages[-1], re.M):
        found.append("Dockerfile: expected a numeric USER that is not root")
    if "packages-debian12.txt" in stages[-1].replace("packages-runtime-debian12.txt", ""):
        found.append("Dockerfile: the image installs the compilers")
    return found


# ------------------------------------------------------------------------------------------------ tests


def at(node, path):
    for key in path:
        node = node[key]
    return node


def put(*path_and_value):
    *path, key, value = path_and_value
    return lambda node: at(node, path).__setitem__(key, value)


def drop(*path):
    *path, key = path
    return lambda node: at(node, path).__delitem__(key)


class Manifests(unittest.TestCase):
    def check(self, read, complaints, faults):
        """No complaint about the files; for each fault, one that holds the words beside it."""
        self.assertEqual(complaints(read()), [])
        for plant, words in faults:
            broken = copy.deepcopy(read())
            plant(broken)
            found = complaints(broken)
            self.assertTrue(any(words in text for text in found), f"expected '{words}', found {found}")

    def test_compose(self):
        services = ("services",)
        self.check(
            read_compose,
            compose_complaints,
            [
                (put(*services, "worker", "memory_limit", "1g"), "memory_limit"),
                (put(*services, "worker", "cap_add", "SYS_ADMIN"), "SYS_ADMIN"),
                (put(*services, "worker", "read_only", False), "worker.read_only"),
                (drop(*services, "gleaner", "cap_drop"), "gleaner.cap_drop"),
                (drop(*services, "worker", "security_opt"), "worker.security_opt"),
                (drop(*services, "worker", "tmpfs"), "worker.tmpfs"),
                (put(*services, "worker", "volumes", ["nowhere:/cache"]), "nowhere is not declared"),
                (put(*services, "coordinator", "ports", ["8780:8780"]), "open to other machines"),
                (drop(*services, "worker", "mem_limit"), "expected mem_limit"),
                (drop(*services, "coordinator", "restart"), "expected restart"),
                (drop(*services, "worker", "stop_grace_period"), "expected stop_grace_period"),
                (drop(*services, "coordinator", "healthcheck"), "expected a healthcheck"),
                (put(*services, "coordinator", "healthcheck", "test", ["CMD", "curl", "x"]), "the farm's programs"),
                (put(*services, "worker", "command", "gleaner-worker --cordinator x"), "no option --cordinator"),
                (put(*services, "coordinator", "volumes", ["data:/dta"]), "expected one for /data"),
                (put(*services, "worker", "depends_on", {"coordinator": {"condition": "service_started"}}), "expected a healthy coordinator"),
                (put(*services, "worker", "container_name", "worker"), "--scale"),
                (put(*services, "coordinator", "build", "dockerfile", "Dockerfile"), "no file Dockerfile"),
            ],
        )

    def test_kubernetes(self):
        index = {(one["kind"], one["metadata"]["name"]): i for i, one in enumerate(read_kubernetes())}
        worker = (index["Deployment", "worker"], "spec")
        worker_pod = (*worker, "template", "spec")
        worker_container = (*worker_pod, "containers", 0)
        coordinator = (index["StatefulSet", "coordinator"], "spec")
        coordinator_container = (*coordinator, "template", "spec", "containers", 0)
        autoscaler = (index["HorizontalPodAutoscaler", "worker"], "spec")
        self.check(
            read_kubernetes,
            kubernetes_complaints,
            [
                (put(*worker_pod, "terminationGracePeriod", 5), "terminationGracePeriod"),
                (put(*worker, "replicas", "three"), "three"),
                (put(*autoscaler, "maxReplica", 3), "maxReplica"),
                (drop(*coordinator, "selector"), "selector"),
                (put(index["Namespace", "gleaner"], "kind", "NameSpace"), "not among the kinds"),
                (put(index["Service", "coordinator"], "metadata", "namespace", "default"), "expected the namespace"),
                (put(*worker, "template", "metadata", "labels", {"a": "b"}), "its selector does not match"),
                (put(*worker_pod, "securityContext", "runAsNonRoot", False), "runAsNonRoot"),
                (put(*worker_pod, "securityContext", "runAsUser", 1000), "the image's"),
                (drop(*worker_pod, "terminationGracePeriodSeconds"), "grace time"),
                (put(*worker_container, "securityContext", "readOnlyRootFilesystem", False), "read-only root"),
                (drop(*worker_container, "resources", "limits", "memory"), "limit of memory"),
                (put(*worker_container, "volumeMounts", 0, "name", "nowhere"), "no volume nowhere"),
                (put(*worker_container, "args", 3, "--thread=2"), "no option --thread"),
                (put(*worker_container, "args", 1, "--coordinator=farm:8780"), "which no service answers"),
                (put(*coordinator_container, "args", 2, "--http=0.0.0.0:81"), "nothing listens on 8781"),
                (put(*coordinator_container, "livenessProbe", "httpGet", "port", "web"), "no port web"),
                (put(index["Service", "coordinator"], "spec", "selector", {"a": "b"}), "selects no pod"),
                (put(index["NetworkPolicy", "worker"], "spec", "podSelector", "matchLabels", {"a": "b"}), "selects no"),
                (put(*coordinator, "serviceName", "farm"), "no service farm"),
                (put(*autoscaler, "scaleTargetRef", "name", "wrkr"), "no Deployment wrkr"),
                (put(*worker, "replicas", 3), "a count of its own"),
                (put(*autoscaler, "metrics", 0, "external", "metric", "name", "frames"), "no metric frames"),
            ],
        )

    def test_commands_of_slurm_and_systemd(self):
        self.check(
            read_commands,
            command_complaints,
            [
                (drop("workers.sbatch"), "expected three command lines"),
                (put("workers.sbatch", ["$bin/gleaner-worker", "--nom", "x"]), "no option --nom"),
                (put("gleaner-worker@.service", ["/usr/bin/sleep", "1"]), "expected one of the farm's programs"),
            ],
        )

    def test_image(self):
        self.check(
            read_image,
            image_complaints,
            [
                (lambda image: image["rooms"].append("attic"), "needs attic/"),
                (lambda image: image["ignore"].remove("!cmake"), "needs cmake"),
                (lambda image: image["ignore"].remove("*"), "leave out"),
                (lambda image: image.update(dockerfile=image["dockerfile"].replace("USER 10001:10001", "")), "USER"),
                (lambda image: image.update(dockerfile=image["dockerfile"].replace("-runtime", "")), "compilers"),
            ],
        )


if __name__ == "__main__":
    unittest.main(argv=[sys.argv[0]], verbosity=2)
