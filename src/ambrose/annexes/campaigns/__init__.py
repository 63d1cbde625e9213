"""Many cases of one plan, on all processors or a cluster: run, resumed, summed up on a page."""

ANNEX = {
    "research command": {"campaign": "command:campaign"},
    "public": {"campaign": "result", "Campaign": "result"},
    "page": {"Campaign": "result:campaign_page"},
}
