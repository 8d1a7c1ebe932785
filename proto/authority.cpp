#include "proto/authority.h"

#include <openssl/err.h>
#include <openssl/rand.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <ctime>
#include <fstream>
#include <span>
#include <sstream>

#include "proto/atomic_file.h"
#include "proto/openssl_handles.h"
#include "proto/token.h"
#include "scene/model/error.h"

namespace gleaner {

namespace fs = std::filesystem;
using openssl::Held;

namespace {

constexpr const char* authority_key_file = "authority.key";
constexpr const char* issued_file = "issued";  // a line each: serial, name, roles, last day and kind, by tabs
constexpr const char* authority_name = "Gleaner farm authority";
constexpr long day = 24 * 3600;

void check(bool done, const char* what) {
  if (!done) throw Error::failed(std::string("OpenSSL: ") + what + " failed");
}

void write(const fs::path& file, const std::string& text, unsigned mode) {
  write_atomically(file.string(), std::as_bytes(std::span(text)), mode);
}

std::string read(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) throw Error::bad_input(file.string(), "", "a file of a farm's authority (gleaner keys init)", "none");
  return {std::istreambuf_iterator<char>(in), {}};
}

std::string pem_of(X509* certificate) {
  return openssl::pem_of([&](BIO* bio) { return PEM_write_bio_X509(bio, certificate); });
}
std::string pem_of(EVP_PKEY* key) {
  return openssl::pem_of(
      [&](BIO* bio) { return PEM_write_bio_PrivateKey(bio, key, nullptr, nullptr, 0, nullptr, nullptr); });
}

Held<EVP_PKEY> new_key() {
  Held<EVP_PKEY> key(EVP_EC_gen("P-256"));
  check(key != nullptr, "making a key");
  return key;
}

void add_extension(X509* certificate, X509* issuer, int kind, const std::string& value) {
  X509V3_CTX context;
  X509V3_set_ctx_nodb(&context);
  X509V3_set_ctx(&context, issuer, certificate, nullptr, nullptr, 0);
  const Held<X509_EXTENSION> extension(X509V3_EXT_conf_nid(nullptr, &context, kind, value.c_str()));
  check(extension && X509_add_ext(certificate, extension.get(), -1) == 1, "adding an extension");
}

Held<BIGNUM> new_serial() {
  unsigned char random[16];
  check(RAND_bytes(random, sizeof random) == 1, "drawing a serial number");
  random[0] = static_cast<unsigned char>((random[0] & 0x3f) | 0x40);  // positive, and always as long
  Held<BIGNUM> serial(BN_bin2bn(random, sizeof random, nullptr));
  check(serial != nullptr, "making a serial number");
  return serial;
}

// A certificate without extensions and signature. It is good from five minutes ago on: clocks differ.
Held<X509> new_certificate(const std::string& name, EVP_PKEY* key, int days) {
  Held<X509> certificate(X509_new());
  check(certificate != nullptr, "making a certificate");
  const Held<BIGNUM> serial = new_serial();
  X509_NAME* subject = X509_get_subject_name(certificate.get());
  check(X509_set_version(certificate.get(), X509_VERSION_3) == 1 &&
            BN_to_ASN1_INTEGER(serial.get(), X509_get_serialNumber(certificate.get())) != nullptr &&
            X509_gmtime_adj(X509_getm_notBefore(certificate.get()), -300) != nullptr &&
            X509_gmtime_adj(X509_getm_notAfter(certificate.get()), day * days) != nullptr &&
            X509_NAME_add_entry_by_txt(subject, "CN", MBSTRING_UTF8,
                                       reinterpret_cast<const unsigned char*>(name.c_str()), -1, -1, 0) == 1 &&
            X509_set_pubkey(certificate.get(), key) == 1,
        "filling in a certificate");
  return certificate;
}

std::string day_of(const std::tm& time) {
  char text[16];
  std::strftime(text, sizeof text, "%Y-%m-%d", &time);
  return text;
}
std::string last_day(X509* certificate) {
  std::tm time{};
  check(ASN1_TIME_to_tm(X509_get0_notAfter(certificate), &time) == 1, "reading a date");
  return day_of(time);
}

void check_end(X509* issuer, std::time_t end) {
  if (X509_cmp_time(X509_get0_notAfter(issuer), &end) < 0)
    throw Error::usage("--days: the authority itself is good until " + last_day(issuer));
}

std::string alternative_names(const std::set<Role>& roles) {
  std::string names;
  for (const Role role : roles) names.append(names.empty() ? "DNS:" : ",DNS:").append(role_dns_name(role));
  return names;
}

void check_name(const std::string& name) {
  const bool plain =
      std::ranges::all_of(name, [](unsigned char c) { return std::isalnum(c) || c == '.' || c == '_' || c == '-'; });
  if (name.empty() || name.size() > 64 || !plain || name[0] == '.')
    throw Error::usage("NAME: expected 1 to 64 of [A-Za-z0-9._-], found \"" + name + "\"");
}

// Of who is to have it.
void check_holder(const std::string& name, const std::set<Role>& roles, const fs::path& to) {
  check_name(name);
  if (roles.empty()) throw Error::usage("--role: expected at least one");
  std::error_code ignored;
  if (fs::exists(to, ignored)) throw Error::usage(to.string() + " is there already: -o takes a new folder");
}

void make_folder(const fs::path& folder) {
  std::error_code problem;
  if (!fs::create_directories(folder, problem))
    throw Error::failed(folder.string() + ": cannot be made" + (problem ? ": " + problem.message() : ""));
}

std::time_t now_plus(int days) { return std::time(nullptr) + day * days; }

}  // namespace

struct Authority::Issuer {
  Held<X509> certificate;
  Held<EVP_PKEY> key;
};

Authority Authority::init(const fs::path& folder, int days) {
  std::error_code ignored;
  if (fs::exists(folder, ignored) && !fs::is_empty(folder, ignored))
    throw Error::usage(folder.string() +
                       " is there and not empty: an authority is made once; gleaner keys issue goes on "
                       "with it");
  fs::create_directories(folder, ignored);
  const Held<EVP_PKEY> key = new_key();
  const Held<X509> certificate = new_certificate(authority_name, key.get(), days);
  X509* const own = certificate.get();
  check(X509_set_issuer_name(own, X509_get_subject_name(own)) == 1, "naming the issuer");
  add_extension(own, own, NID_basic_constraints, "critical,CA:TRUE,pathlen:0");
  add_extension(own, own, NID_key_usage, "critical,keyCertSign,cRLSign");
  add_extension(own, own, NID_subject_key_identifier, "hash");
  check(X509_sign(own, key.get(), EVP_sha256()) > 0, "signing");
  write(folder / authority_key_file, pem_of(key.get()), 0600);
  write(folder / authority_file, pem_of(own), 0644);
  write(folder / issued_file, "", 0644);
  Authority authority(folder);
  authority.issue("coordinator", {Role::coordinate}, days - 1, folder / "coordinator");
  return authority;
}

Authority::Authority(fs::path folder) : folder_(std::move(folder)) { read(folder_ / authority_key_file); }

Authority::Issuer Authority::issuer() const {
  Issuer issuer{.certificate = openssl::parse_certificate(read(folder_ / authority_file)),
                .key = openssl::parse_key(read(folder_ / authority_key_file))};
  if (!issuer.certificate || !issuer.key || X509_check_private_key(issuer.certificate.get(), issuer.key.get()) != 1)
    throw Error::bad_input(folder_.string(), "", "an authority's certificate and its key", "others");
  return issuer;
}

// Before what is issued is anywhere else: what nobody knows of cannot be revoked.
void Authority::record(const Issued& one) const {
  write(folder_ / issued_file,
        read(folder_ / issued_file) + one.serial + "\t" + one.name + "\t" + role_words(one.roles) + "\t" +
            one.good_until + "\t" + (one.token ? "token" : "certificate") + "\n",
        0644);
}

void Authority::issue(const std::string& name, const std::set<Role>& roles, int days, const fs::path& to) const {
  check_holder(name, roles, to);
  const Issuer by = issuer();
  X509* const authority = by.certificate.get();
  check_end(authority, now_plus(days));
  const Held<EVP_PKEY> key = new_key();
  const Held<X509> certificate = new_certificate(name, key.get(), days);
  X509* const own = certificate.get();
  check(X509_set_issuer_name(own, X509_get_subject_name(authority)) == 1, "naming the issuer");
  add_extension(own, authority, NID_basic_constraints, "critical,CA:FALSE");
  add_extension(own, authority, NID_key_usage, "critical,digitalSignature");
  add_extension(own, authority, NID_ext_key_usage, "serverAuth,clientAuth");
  add_extension(own, authority, NID_subject_alt_name, alternative_names(roles));
  check(X509_sign(own, by.key.get(), EVP_sha256()) > 0, "signing");

  record({.serial = openssl::serial_of(own), .name = name, .roles = roles, .good_until = last_day(own)});
  make_folder(to);
  write(to / authority_file, pem_of(authority), 0644);
  write(to / certificate_file, pem_of(own), 0644);
  write(to / key_file, pem_of(key.get()), 0600);
}

void Authority::issue_token(const std::string& name, const std::set<Role>& roles, int days, const fs::path& to) const {
  check_holder(name, roles, to);
  for (const Role role : {Role::work, Role::coordinate})
    if (roles.contains(role))
      throw Error::usage(std::string("--token: who is to ") + role_name(role) +
                         " needs a certificate, which others can check; tokens are for people");
  const Issuer by = issuer();
  const std::time_t end = now_plus(days);
  check_end(by.certificate.get(), end);
  const std::string serial = openssl::hexadecimal(*new_serial());
  const std::string token = sign_token({.name = name, .serial = serial, .roles = roles},
                                       std::chrono::system_clock::from_time_t(end), pem_of(by.key.get()));
  std::tm utc{};
  ::gmtime_r(&end, &utc);
  record({.serial = serial, .name = name, .roles = roles, .good_until = day_of(utc), .token = true});
  make_folder(to);
  write(to / authority_file, pem_of(by.certificate.get()), 0644);
  write(to / token_file, token + "\n", 0600);
}

std::vector<Authority::Issued> Authority::issued() const {
  std::set<std::string> revoked;
  if (std::ifstream in(revoked_list()); in)
    for (std::string line; std::getline(in, line);) revoked.insert(line.substr(0, line.find_first_of(" \t")));
  std::vector<Issued> all;
  std::istringstream lines(read(folder_ / issued_file));
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    Issued one;
    std::string roles;
    std::getline(words, one.serial, '\t');
    std::getline(words, one.name, '\t');
    std::getline(words, roles, '\t');
    std::getline(words, one.good_until, '\t');
    std::string kind;  // none in lists of older versions: certificates
    std::getline(words, kind, '\t');
    one.token = kind == "token";
    std::istringstream each(roles);
    for (std::string role; std::getline(each, role, ',');) one.roles.insert(parse_role(role));
    one.revoked = revoked.contains(one.serial);
    all.push_back(std::move(one));
  }
  return all;
}

int Authority::revoke(const std::string& name) const {
  std::string list;
  if (std::ifstream in(revoked_list(), std::ios::binary); in) list.assign(std::istreambuf_iterator<char>(in), {});
  int revoked = 0;
  for (const Issued& one : issued()) {
    if (one.name != name || one.revoked) continue;
    list += one.serial + " " + one.name + "\n";
    ++revoked;
  }
  if (revoked == 0)
    throw Error::usage("NAME: \"" + name + "\" has no certificate and no token that is good (gleaner keys list)");
  write(revoked_list(), list, 0644);
  return revoked;
}

}  // namespace gleaner
