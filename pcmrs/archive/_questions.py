"""Questions that are often asked about many cells, as SQL that DuckDB and PostgreSQL both understand."""

from __future__ import annotations

from typing import Final, NamedTuple

_STOPS: Final = """
WITH found AS (
    SELECT journal, session_id, sequence, kind, site, cell, time, source, operation, branch, reason,
        (result->>'text') AS text,
        max(CASE WHEN kind = 'device' THEN sequence END)
            OVER (PARTITION BY journal, session_id ORDER BY sequence) AS stop
    FROM rows
    WHERE (kind = 'device' AND source <> 'shutdown' AND (result->>'danger') = 'true'
            AND operation NOT IN ('hold_not_confirmed', 'fail_stop', 'journal_reopened'))
        OR (kind = 'outcome' AND decision IN ('failed', 'unknown'))
), ended AS (
    SELECT journal, session_id, stop, reason, string_agg(branch || '.' || operation, ', ' ORDER BY sequence) AS ended
    FROM found WHERE kind = 'outcome' GROUP BY journal, session_id, stop, reason
)
SELECT found.time, found.site, found.cell, found.source AS who, found.operation AS why, ended.ended AS what,
    found.text, found.journal, found.sequence
FROM found LEFT JOIN ended ON ended.journal = found.journal AND ended.session_id = found.session_id
    AND ended.stop = found.sequence AND ended.reason = found.operation
WHERE found.kind = 'device'
ORDER BY found.time, found.journal, found.sequence
"""

_ERRORS: Final = """
WITH tools AS (
    SELECT journal, session_id, max(verdict_result->'calibration'->>'tool') AS tool
    FROM rows
    WHERE kind = 'outcome' AND branch = 'robot' AND operation = 'connect' AND decision = 'accepted'
    GROUP BY journal, session_id
), errors AS (
    SELECT rows.site, rows.cell, rows.workflow, coalesce(tools.tool, 'not known') AS tool,
        1e3 * CAST(verdict_result->>'translation_error' AS DOUBLE PRECISION) AS mm,
        180.0 / pi() * CAST(verdict_result->>'rotation_error' AS DOUBLE PRECISION) AS deg
    FROM rows LEFT JOIN tools ON tools.journal = rows.journal AND tools.session_id = rows.session_id
    WHERE kind = 'outcome' AND branch = 'placement' AND operation = 'confirm' AND decision = 'accepted'
        AND (verdict_result->>'translation_error') IS NOT NULL
)
SELECT {by}, count(*) AS placements, avg(mm) AS mean_mm, stddev_samp(mm) AS sd_mm, max(mm) AS max_mm,
    avg(deg) AS mean_deg
FROM errors GROUP BY {by} ORDER BY {by}
"""

_DECISIONS: Final = """
SELECT site, cell, branch, operation, decision, reason, count(*) AS commands
FROM rows WHERE kind = 'outcome'
GROUP BY site, cell, branch, operation, decision, reason
ORDER BY commands DESC, site, cell, branch, operation, decision, reason
"""

_SESSIONS: Final = """
SELECT site, cell, workflow, session_id, min(time) AS began, max(time) AS ended, count(*) AS rows
FROM rows GROUP BY site, cell, workflow, journal, session_id ORDER BY began, site, cell
"""


class Question(NamedTuple):
    """A question.

    Attributes:
        title: What it answers.
        sql: One SELECT about the table ``rows``.
    """

    title: str
    sql: str


QUESTIONS: Final = {
    "stops": Question("Who stopped what: each Stop, and the operations that it ended", _STOPS),
    "errors-by-tool": Question("Errors of the accepted placements by tool", _ERRORS.format(by="workflow, tool")),
    "errors-by-site": Question("Errors of the accepted placements by site", _ERRORS.format(by="workflow, site")),
    "decisions": Question("Number of commands by cell, operation, decision and reason", _DECISIONS),
    "sessions": Question("Runs of daemons with their first and last rows", _SESSIONS),
}
"""Questions by name."""
