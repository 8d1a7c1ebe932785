#include "proto/credentials.h"

#include <grpc/grpc_security_constants.h>
#include <grpcpp/security/auth_metadata_processor.h>

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <mutex>
#include <optional>
#include <set>
#include <sstream>

#include "proto/openssl_handles.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner {

namespace fs = std::filesystem;
using openssl::Held;

namespace {

std::string read(const fs::path& file, const std::string& what) {
  std::ifstream in(file, std::ios::binary);
  if (!in) throw Error::bad_input(file.string(), "", what + " (gleaner keys makes them)", "no file that can be read");
  return {std::istreambuf_iterator<char>(in), {}};
}

Held<X509> certificate_in(const fs::path& file, const std::string& pem) {
  Held<X509> certificate = openssl::parse_certificate(pem);
  if (!certificate) throw Error::bad_input(file.string(), "", "a certificate (PEM)", "something else");
  if (X509_cmp_current_time(X509_get0_notAfter(certificate.get())) <= 0)
    throw Error::bad_input(file.string(), "", "a certificate that is still good", "one that has expired");
  return certificate;
}

// gRPC of Debian 12 cannot be told to leave TLS 1.2 out. It can be told what TLS 1.2 may encrypt with: by this, which
// wants keys of a kind that no farm has, nothing.
void leave_tls_1_2_out() { ::setenv("GRPC_SSL_CIPHER_SUITES", "DHE-DSS-AES256-GCM-SHA384", 0); }

// Decides, before a call begins, whether its caller may make it.
class Doorkeeper final : public grpc::AuthMetadataProcessor {
 public:
  Doorkeeper(const Keys& keys, MethodRule rule) : identities_(keys), revocations_(keys), rule_(std::move(rule)) {}

  bool IsBlocking() const override { return false; }

  grpc::Status Process(const InputMetadata& metadata, grpc::AuthContext* context, OutputMetadata*,
                       OutputMetadata*) override {
    const std::optional<Peer> peer = identities_.of(*context, metadata);
    if (!peer)
      return {grpc::StatusCode::UNAUTHENTICATED,
              "expected a certificate or a token by the farm's authority that is still good (gleaner keys issue)"};
    if (revocations_.contains(peer->serial))
      return {grpc::StatusCode::UNAUTHENTICATED, "what " + peer->name + " shows was revoked"};
    const auto path = metadata.find(":path");
    if (path == metadata.end()) return {grpc::StatusCode::UNAUTHENTICATED, "a call without a method"};
    const Role needed = rule_(std::string_view(path->second.data(), path->second.size()));
    if (peer->roles.contains(needed)) return grpc::Status::OK;
    return {grpc::StatusCode::PERMISSION_DENIED, peer->name + " may not " + role_name(needed) +
                                                     " with what it shows (gleaner keys issue --role " +
                                                     role_name(needed) + ")"};
  }

 private:
  Identities identities_;
  Revocations revocations_;
  const MethodRule rule_;
};

// Of the connection's certificate.
std::optional<Peer> certified(const grpc::AuthContext& context) {
  const auto first = [&](const char* property) {
    const auto values = context.FindPropertyValues(property);
    return values.empty() ? std::string() : std::string(values.front().data(), values.front().size());
  };
  const Held<X509> certificate = openssl::parse_certificate(first(GRPC_X509_PEM_CERT_PROPERTY_NAME));
  if (!certificate) return std::nullopt;
  Peer peer{.name = printable(first(GRPC_X509_CN_PROPERTY_NAME)),
            .serial = openssl::serial_of(certificate.get()),
            .roles = {}};
  for (const grpc::string_ref& name : context.FindPropertyValues(GRPC_X509_SAN_PROPERTY_NAME))
    for (const Role role : every_role)
      if (std::string(name.data(), name.size()) == role_dns_name(role)) peer.roles.insert(role);
  peer.roles = with_included(std::move(peer.roles));
  return peer;
}

}  // namespace

std::optional<Peer> Identities::of(const grpc::AuthContext& context, const Metadata& metadata) {
  if (std::optional<Peer> peer = certified(context)) return peer;
  constexpr std::string_view scheme = "Bearer ";  // RFC 6750
  const auto [first, last] = metadata.equal_range("authorization");
  for (auto at = first; at != last; ++at) {
    const std::string_view value(at->second.data(), at->second.size());
    if (!value.starts_with(scheme)) continue;
    if (std::optional<Peer> peer = tokens_.read(value.substr(scheme.size()))) return peer;
  }
  return std::nullopt;
}

bool Revocations::contains(const std::string& serial) {
  std::lock_guard lock(mutex_);
  std::error_code missing;
  const auto written = fs::last_write_time(file_, missing);
  if (missing) return false;  // nobody was ever revoked
  if (written != read_at_) {
    std::ifstream in(file_);
    serials_.clear();
    for (std::string line; std::getline(in, line);) {
      std::istringstream words(line);
      if (std::string number; words >> number) serials_.insert(number);
    }
    read_at_ = written;
  }
  return serials_.contains(serial);
}

Keys load_keys(const fs::path& folder) {
  Keys keys{.folder = folder,
            .authority = read(folder / authority_file, "the certificate of the farm's authority"),
            .certificate = {},
            .key = {},
            .token = {}};
  const Held<X509> authority = certificate_in(folder / authority_file, keys.authority);
  std::error_code ignored;
  if (fs::exists(folder / token_file, ignored) && !fs::exists(folder / certificate_file, ignored)) {
    std::istringstream(read(folder / token_file, "a token by the farm's authority")) >> keys.token;
    if (!TokenReader(keys.authority).read(keys.token))
      throw Error::bad_input((folder / token_file).string(), "",
                             "a token by the authority of " + (folder / authority_file).string() +
                                 " that is still good (gleaner keys issue --token)",
                             "another text, or one that has expired");
    return keys;
  }
  keys.certificate = read(folder / certificate_file, "a certificate by the farm's authority");
  keys.key = read(folder / key_file, "the certificate's key");
  const Held<X509> own = certificate_in(folder / certificate_file, keys.certificate);
  if (X509_verify(own.get(), X509_get0_pubkey(authority.get())) != 1)
    throw Error::bad_input((folder / certificate_file).string(), "",
                           "a certificate by the authority of " + (folder / authority_file).string(), "one by another");
  const Held<EVP_PKEY> key = openssl::parse_key(keys.key);
  if (!key) throw Error::bad_input((folder / key_file).string(), "", "a private key (PEM)", "something else");
  if (X509_check_private_key(own.get(), key.get()) != 1)
    throw Error::bad_input((folder / key_file).string(), "", "the key of " + (folder / certificate_file).string(),
                           "another one");
  return keys;
}

void require_certificate(const Keys& keys, const std::string& who) {
  if (keys.token.empty()) return;
  throw Error::usage(keys.folder.string() + ": " + who +
                     " needs a certificate, which others can check; this is a token, for people (gleaner keys issue "
                     "without --token)");
}

std::shared_ptr<const Keys> own_keys() {
  const char* folder = std::getenv("GLEANER_KEYS");
  return folder && *folder ? std::make_shared<const Keys>(load_keys(folder)) : nullptr;
}

std::shared_ptr<grpc::ServerCredentials> server_credentials(std::shared_ptr<const Keys> keys, MethodRule rule,
                                                            Admits admits) {
  if (!keys) return grpc::InsecureServerCredentials();
  require_certificate(*keys, "a server");
  leave_tls_1_2_out();
  grpc::SslServerCredentialsOptions options(admits == Admits::tokens_too
                                                ? GRPC_SSL_REQUEST_CLIENT_CERTIFICATE_AND_VERIFY
                                                : GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY);
  options.pem_root_certs = keys->authority;
  options.pem_key_cert_pairs.push_back({keys->key, keys->certificate});
  auto credentials = grpc::SslServerCredentials(options);
  credentials->SetAuthMetadataProcessor(std::make_shared<Doorkeeper>(*keys, std::move(rule)));
  return credentials;
}

std::shared_ptr<grpc::ChannelCredentials> channel_credentials(const Keys* keys, Role expected,
                                                              grpc::ChannelArguments& arguments) {
  if (!keys) return grpc::InsecureChannelCredentials();
  leave_tls_1_2_out();
  arguments.SetSslTargetNameOverride(role_dns_name(expected));
  auto channel = grpc::SslCredentials({keys->authority, keys->key, keys->certificate});
  if (keys->token.empty()) return channel;
  return grpc::CompositeChannelCredentials(channel, grpc::AccessTokenCredentials(keys->token));
}

}  // namespace gleaner
