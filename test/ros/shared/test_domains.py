import socket
import subprocess
import sys

import pytest

from tissue_sim.errors import UserError
from tissue_sim.ros.shared import domains
from tissue_sim.ros.shared.domains import claim_domain

CLAIM = """
from tissue_sim.ros.shared.domains import claim_domain
domain, claim = claim_domain()
print(domain, flush=True)
input()
"""


@pytest.fixture
def only(monkeypatch):
    """One domain that was free a moment ago, the only one there is."""
    domain, claim = claim_domain()
    claim.close()
    monkeypatch.setattr(domains, "DOMAINS", range(domain, domain + 1))
    return domain


def test_a_claim_holds_until_it_is_closed(only):
    domain, claim = claim_domain()
    assert domain == only
    with pytest.raises(UserError, match="ROS_DOMAIN_ID"):
        claim_domain()
    claim.close()
    domain, claim = claim_domain()
    claim.close()
    assert domain == only


def test_a_claim_holds_for_other_processes_and_ends_with_its_own(monkeypatch):
    words = [sys.executable, "-c", CLAIM]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        domain = int(other.stdout.readline())
        monkeypatch.setattr(domains, "DOMAINS", range(domain, domain + 1))
        with pytest.raises(UserError, match="in use"):
            claim_domain()
        other.communicate("\n")
    with claim_domain()[1]:
        pass


@pytest.mark.parametrize("participant", [0, 3])
def test_a_domain_with_a_participant_is_not_chosen(only, participant):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as discovery:
        discovery.bind(("", 7410 + 250 * only + 2 * participant))
        with pytest.raises(UserError, match="in use"):
            claim_domain()
    with claim_domain()[1]:
        pass
