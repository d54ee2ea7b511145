"""The model audit of simulated robots."""

from wbc_controller.safety.model_audit import ModelAudit


def audited(simulation, seconds):
    """Run a simulation; return the report of its audit, or None, for each cycle."""
    controller, reports = simulation.controller, []
    audit = ModelAudit(controller.model, controller.config.settings.audit, controller.period)

    def check(simulation):
        result = simulation.result
        reports.append(audit.check(result.state, controller.dynamics, result.solution, result.command))

    simulation.run(seconds, check)
    return reports
