"""What a run must repeat of its records: all but times and origins."""

from dataclasses import replace


def numbers(records):
    """The records without what differs from run to run."""
    return [
        replace(
            record,
            seconds={},
            provenance={},
            metrics={k: v for k, v in record.metrics.items() if not k.endswith("_seconds")},
        )
        for record in records
    ]


def by_key(records):
    """The same, in an order of its own."""
    return sorted(numbers(records), key=lambda record: record.key)
